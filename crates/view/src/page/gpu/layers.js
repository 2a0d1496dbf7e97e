/**
 * Passes of the page's own, in WGSL: coverage and depth of a picture, which the engine's passes do
 * not make, and the picture as half floats. They follow the constants, the camera and the footprint
 * of the engine's shaders.
 */

/** In: parameters of a shard. Out: depth of each splat's centre along the viewing axis. */
export const DEPTHS = `
@group(0) @binding(0) var<uniform> camera: Camera;
@group(0) @binding(1) var<uniform> shard: Shard;
@group(0) @binding(2) var<storage, read> parameters: array<f32>;
@group(0) @binding(3) var<storage, read_write> depths: array<f32>;

@compute @workgroup_size(256)
fn depths_of_splats(@builtin(workgroup_id) workgroup: vec3u, @builtin(local_invocation_index) local: u32) {
  let i = group_index(workgroup) * 256u + local;
  if (i >= shard.len) { return; }
  let p = vec3f(parameters[i], parameters[shard.stride + i], parameters[2u * shard.stride + i]);
  depths[shard.base + i] = dot(camera.row_z.xyz, p) + camera.row_z.w;
}
`;

/** In: what pass rasterize takes, depths. Out: of each sample its coverage, and the sum of depths by their blending weights. */
export const LAYERS = `
@group(0) @binding(0) var<uniform> camera: Camera;
@group(0) @binding(1) var<storage, read> footprints: array<Footprint>;
@group(0) @binding(2) var<storage, read> ranges: array<vec2u>;
@group(0) @binding(3) var<storage, read> sorted_entries: array<u32>;
@group(0) @binding(4) var<storage, read> entries: array<Entry>;
@group(0) @binding(5) var<storage, read> depths: array<f32>;
@group(0) @binding(6) var<storage, read_write> layers: array<vec2f>;

@compute @workgroup_size(256)
fn layers_of_samples(@builtin(workgroup_id) workgroup: vec3u, @builtin(local_invocation_index) local: u32) {
  let tile = group_index(workgroup);
  if (tile >= camera.tiles.x * camera.tiles.y) { return; }
  let at = vec2u(tile % camera.tiles.x, tile / camera.tiles.x) * TILE_PX + tile_pixel(local);
  if (any(at >= camera.size_px)) { return; }
  let range = ranges[tile];
  var transmittance = 1.0;
  var sum = 0.0;
  for (var entry = range.x; entry < range.y; entry++) {
    let pair = entries[sorted_entries[entry]];
    if (((pair.blocks >> (local / BLOCK_PIXELS)) & 1u) == 0u) { continue; }
    let f = footprints[pair.splat];
    let seen = see(f.mean_px, vec3f(f.root_x, f.root_xy, f.root_y), f.log2_opacity, vec2f(at) + 0.5);
    if (seen.log2_alpha < f.log2_threshold) { continue; }
    let alpha = min(exp2(seen.log2_alpha), camera.max_alpha);
    let left = transmittance - alpha * transmittance;
    if (left < camera.min_transmittance) { break; }
    sum += alpha * transmittance * depths[pair.splat];
    transmittance = left;
  }
  layers[at.y * camera.size_px.x + at.x] = vec2f(1.0 - transmittance, sum);
}
`;

/**
 * In: samples in normalised units. Out: means of the samples of a pixel, in the units of the data
 * set, as planes: radiance and coverage as half floats, rounded to the nearest, depth as floats.
 * Radiance is divided by a power of two so that it stays in the range of half floats, by the rule of
 * the server (frame.rs).
 */
export const PACK = `
struct Picture { width: u32, height: u32, samples: u32, has_layers: u32, radiance_scale: f32, depth_unit: f32, alpha_at: u32, depth_at: u32 }
struct Packed { peak: atomic<u32>, exponent: i32, padding_0: u32, padding_1: u32, words: array<u32> }
@group(0) @binding(0) var<uniform> picture: Picture;
@group(0) @binding(1) var<storage, read> image: array<f32>;
@group(0) @binding(2) var<storage, read> layers: array<vec2f>;
@group(0) @binding(3) var<storage, read_write> out: Packed;

const LARGEST_HALF = 65504.0;
var<workgroup> group_peak: atomic<u32>;

fn radiance_at(pixel: u32) -> vec3f {
  let at = vec2u(pixel % picture.width, pixel / picture.width) * picture.samples;
  var sum = vec3f(0.0);
  for (var y = 0u; y < picture.samples; y++) {
    for (var x = 0u; x < picture.samples; x++) {
      let sample = 3u * ((at.y + y) * picture.width * picture.samples + at.x + x);
      sum += vec3f(image[sample], image[sample + 1u], image[sample + 2u]);
    }
  }
  return sum / f32(picture.samples * picture.samples) * picture.radiance_scale;
}

fn layers_at(pixel: u32) -> vec2f {
  let at = vec2u(pixel % picture.width, pixel / picture.width) * picture.samples;
  var sum = vec2f(0.0);
  for (var y = 0u; y < picture.samples; y++) {
    for (var x = 0u; x < picture.samples; x++) {
      sum += layers[(at.y + y) * picture.width * picture.samples + at.x + x];
    }
  }
  return sum / f32(picture.samples * picture.samples);
}

@compute @workgroup_size(256)
fn peak(@builtin(workgroup_id) workgroup: vec3u, @builtin(local_invocation_index) local: u32) {
  if (local == 0u) { atomicStore(&group_peak, 0u); }
  workgroupBarrier();
  let pixel = group_index(workgroup) * 256u + local;
  if (pixel < picture.width * picture.height) {
    let v = abs(radiance_at(pixel));
    for (var c = 0u; c < 3u; c++) {
      // Bits of positive floats have the order of the numbers.
      if (is_finite(v[c])) { atomicMax(&group_peak, bitcast<u32>(v[c])); }
    }
  }
  workgroupBarrier();
  if (local == 0u) { atomicMax(&out.peak, atomicLoad(&group_peak)); }
}

@compute @workgroup_size(1)
fn exponent() {
  let peak = bitcast<f32>(atomicLoad(&out.peak));
  var e = 0;
  if (peak > LARGEST_HALF) {
    e = 1;
    while (e < 126 && ldexp(peak, -e) > LARGEST_HALF) { e++; }
  } else if (peak > 0.0 && peak < 1.0) {
    e = i32(atomicLoad(&out.peak) >> 23u) - 127 - 10;
  }
  out.exponent = clamp(e, -126, 126);
}

fn half_of(value: f32) -> u32 {
  let bits = bitcast<u32>(value);
  let sign = (bits >> 16u) & 0x8000u;
  let size = bits & 0x7fffffffu;
  if (size > 0x7f800000u) { return sign | 0x7e00u; }
  if (size >= 0x477ff000u) { return sign | 0x7c00u; }
  if (size <= 0x33000000u) { return sign; }
  var digits = size - 0x38000000u;
  var dropped = 13u;
  if (size < 0x38800000u) {
    digits = (size & 0x7fffffu) | 0x800000u;
    dropped = 126u - (size >> 23u);
  }
  let kept = digits >> dropped;
  let rest = digits & ((1u << dropped) - 1u);
  let middle = 1u << (dropped - 1u);
  return sign | (kept + select(0u, 1u, rest > middle || (rest == middle && (kept & 1u) == 1u)));
}

@compute @workgroup_size(256)
fn pack(@builtin(workgroup_id) workgroup: vec3u, @builtin(local_invocation_index) local: u32) {
  let pair = group_index(workgroup) * 256u + local;
  let pixels = picture.width * picture.height;
  if (2u * pair >= pixels) { return; }
  let factor = ldexp(1.0, -out.exponent);
  let last = min(2u * pair + 1u, pixels - 1u);
  let a = radiance_at(2u * pair) * factor;
  let b = radiance_at(last) * factor;
  out.words[3u * pair] = half_of(a.x) | (half_of(a.y) << 16u);
  out.words[3u * pair + 1u] = half_of(a.z) | (half_of(b.x) << 16u);
  out.words[3u * pair + 2u] = half_of(b.y) | (half_of(b.z) << 16u);
  if (picture.has_layers == 0u) { return; }
  let layers_a = layers_at(2u * pair);
  let layers_b = layers_at(last);
  out.words[picture.alpha_at + pair] = half_of(layers_a.x) | (half_of(layers_b.x) << 16u);
  out.words[picture.depth_at + 2u * pair] = depth_of(layers_a);
  out.words[picture.depth_at + 2u * pair + 1u] = depth_of(layers_b);
}

// Bits of the depth; of infinity where there are no splats.
fn depth_of(layers: vec2f) -> u32 {
  return select(0x7f800000u, bitcast<u32>(layers.y / layers.x * picture.depth_unit), layers.x > 0.0);
}
`;
