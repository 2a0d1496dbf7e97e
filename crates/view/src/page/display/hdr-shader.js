/**
 * The picture for a screen of high dynamic range, in WGSL: as in shader.js, but without its clamp at
 * white. 1 is the white of the screen; the canvas takes encoded sRGB values beyond it.
 *
 * Without a curve light above white stays linear, up to the headroom. With a curve nothing changes up
 * to white; a pixel that is p times brighter than white is 1 + (p - 1)(H - 1) / (p - 1 + H - 1) times
 * brighter than the curve makes it, which begins with slope 1 and tends to the headroom H.
 */
export const HDR = `
struct Look {
  rec709: array<vec4f, 3>,
  weights: vec4f,
  zebra_stops: vec2f,
  canvas: vec2f,
  picture_px: vec2u,
  truth_px: vec2u,
  picture_scale: f32,
  truth_scale: f32,
  gain: f32,
  wipe: f32,
  headroom: f32,
  dots: f32,
  curve: u32,
  // 0 the picture, 1 a wipe, 2 the ground truth alone.
  compare: u32,
  zebra: u32,
  smooth_picture: u32,
  padding: vec2u,
}
@group(0) @binding(0) var<uniform> look: Look;
@group(0) @binding(1) var<storage, read> picture: array<u32>;
@group(0) @binding(2) var<storage, read> truth: array<u32>;

@vertex
fn corner(@builtin(vertex_index) index: u32) -> @builtin(position) vec4f {
  return vec4f(vec2f(f32((index << 1u) & 2u), f32(index & 2u)) * 2.0 - 1.0, 0.0, 1.0);
}

const ACES_IN = mat3x3f(0.59719, 0.07600, 0.02840, 0.35458, 0.90834, 0.13383, 0.04823, 0.01566, 0.83777);
const ACES_OUT = mat3x3f(1.60475, -0.10208, -0.00327, -0.53108, 1.10813, -0.07276, -0.07367, -0.00605, 1.07602);
const AGX_IN = mat3x3f(0.84247906, 0.042328242, 0.042375655, 0.0784336, 0.87846864, 0.0784336, 0.079223745, 0.07916613, 0.879143);
const AGX_OUT = mat3x3f(1.196879, -0.052896852, -0.052971636, -0.09802088, 1.1519031, -0.09804345, -0.09902974, -0.09896118, 1.1510737);

fn srgb(light: vec3f) -> vec3f {
  let v = max(light, vec3f(0.0));
  return select(12.92 * v, 1.055 * pow(v, vec3f(1.0 / 2.4)) - 0.055, v > vec3f(0.0031308));
}
fn light_of(code: vec3f) -> vec3f {
  let v = max(code, vec3f(0.0));
  return select(v / 12.92, pow((v + 0.055) / 1.055, vec3f(2.4)), v > vec3f(0.04045));
}
fn agx(v: vec3f) -> vec3f {
  let x = clamp((log2(max(AGX_IN * v, vec3f(1.1754944e-38))) + 12.473931) / 16.5, vec3f(0.0), vec3f(1.0));
  let y = -0.00232 + x * (0.1191 + x * (0.4298 + x * (-6.868 + x * (31.96 + x * (-40.14 + x * 15.5)))));
  return AGX_OUT * y;
}
// The curve's codes, 0 to 1.
fn curve_of(v: vec3f) -> vec3f {
  if (look.curve == 1u) { return log(1.0 + 5000.0 * v) / log(5001.0); }
  if (look.curve == 2u) { return srgb(v / (1.0 + dot(v, vec3f(0.2126, 0.7152, 0.0722)))); }
  if (look.curve == 3u) {
    let a = ACES_IN * v;
    return srgb(ACES_OUT * ((a * (a + 0.0245786) - 0.000090537) / (a * (0.983729 * a + 0.432951) + 0.238081)));
  }
  return agx(v);
}
fn display(radiance: vec3f) -> vec3f {
  let rgb = vec3f(dot(look.rec709[0].xyz, radiance), dot(look.rec709[1].xyz, radiance), dot(look.rec709[2].xyz, radiance));
  let v = clamp(rgb * look.gain, vec3f(0.0), vec3f(1e9));
  if (look.curve == 0u) { return srgb(min(v, vec3f(look.headroom))); }
  let code = clamp(curve_of(v), vec3f(0.0), vec3f(1.0));
  let beyond = max(max(v.r, max(v.g, v.b)) - 1.0, 0.0);
  let room = look.headroom - 1.0;
  if (beyond == 0.0 || room <= 0.0) { return code; }
  return srgb(light_of(code) * (1.0 + beyond * room / (beyond + room)));
}

fn half_at(is_truth: bool, i: u32) -> f32 {
  var word = 0u;
  if (is_truth) { word = truth[i >> 1u]; } else { word = picture[i >> 1u]; }
  return unpack2x16float(word)[i & 1u];
}
fn pixel(is_truth: bool, at: vec2i) -> vec3f {
  let size = select(look.picture_px, look.truth_px, is_truth);
  let inside = vec2u(clamp(at, vec2i(0), vec2i(size) - 1));
  let i = 3u * (inside.y * size.x + inside.x);
  return vec3f(half_at(is_truth, i), half_at(is_truth, i + 1u), half_at(is_truth, i + 2u));
}
fn radiance_at(is_truth: bool, place: vec2f) -> vec3f {
  if (is_truth) { return pixel(true, vec2i(place * vec2f(look.truth_px))) * look.truth_scale; }
  let at = place * vec2f(look.picture_px);
  if (look.smooth_picture == 0u) { return pixel(false, vec2i(at)) * look.picture_scale; }
  let corner = floor(at - 0.5);
  let part = at - 0.5 - corner;
  let first = vec2i(corner);
  let top = mix(pixel(false, first), pixel(false, first + vec2i(1, 0)), part.x);
  let bottom = mix(pixel(false, first + vec2i(0, 1)), pixel(false, first + vec2i(1, 1)), part.x);
  return mix(top, bottom, part.y) * look.picture_scale;
}

@fragment
fn shade(@builtin(position) position: vec4f) -> @location(0) vec4f {
  let place = position.xy / look.canvas;
  let is_truth = look.compare == 2u || (look.compare == 1u && place.x < look.wipe);
  let radiance = radiance_at(is_truth, place);
  var rgb = display(radiance);
  if (look.zebra != 0u) {
    let stops = log2(max(dot(look.weights.xyz, radiance) * look.gain, 1e-30) / 0.18);
    let y = look.canvas.y - position.y;
    let stripe = (position.x + y) / look.dots % 10.0;
    let back = (position.x - y) / look.dots;
    if (stops > look.zebra_stops.y && stripe < 5.0) { rgb = vec3f(select(1.0, 0.0, stripe < 2.5)); }
    if (stops < look.zebra_stops.x && back - 10.0 * floor(back / 10.0) < 3.0) { rgb = vec3f(0.35); }
  }
  return vec4f(rgb, 1.0);
}
`;
