/**
 * The shader of the picture: half-float radiance to the screen. Tone curves are those of the
 * program (`luxel_core::tone`), which names their sources. What is chosen is compiled in, since a
 * processor that stands in for a graphics card pays for every branch.
 */

import { pointShader } from "../math/projections.js";

/** What a shader is compiled for: indices into CURVES, LAYERS, COMPARES and ERRORS; `absolute` for bands of luminance; the projection of the depth that is there. @typedef {{ curve: number, layer: number, compare: number, zebra: boolean, absolute: boolean, error: number, projection: import("../math/projections.js").Kind }} Choice */

export const VERTEX = `#version 300 es
out vec2 place;
void main() {
  vec2 corner = vec2((gl_VertexID << 1) & 2, gl_VertexID & 2);
  place = vec2(corner.x, 1.0 - corner.y);
  gl_Position = vec4(corner * 2.0 - 1.0, 0.0, 1.0);
}`;

/** Index of the curve that is a table. */
const TABLE = 5;
/** A display of OpenColorIO, interpolated in tetrahedra as `luxel::display_lut` does. */
const TABLE_SHADER = `
precision highp sampler3D;
uniform sampler3D table;
uniform vec2 tableRange;
vec3 byTable(vec3 v) {
  float last = float(textureSize(table, 0).x - 1);
  vec3 at = clamp(last * (log2(max(v, 1.1754944e-38)) - tableRange.x) / (tableRange.y - tableRange.x), 0.0, last);
  vec3 cell = min(floor(at), last - 1.0);
  vec3 w = at - cell;
  const ivec3 X = ivec3(1, 0, 0), Y = ivec3(0, 1, 0), Z = ivec3(0, 0, 1);
  ivec3 most = w.x >= w.y ? (w.x >= w.z ? X : Z) : (w.y >= w.z ? Y : Z);
  ivec3 least = w.x < w.y ? (w.x < w.z ? X : Z) : (w.y < w.z ? Y : Z);
  float high = max(w.x, max(w.y, w.z)), low = min(w.x, min(w.y, w.z)), middle = w.x + w.y + w.z - high - low;
  ivec3 c = ivec3(cell);
  return (1.0 - high) * texelFetch(table, c, 0).rgb + (high - middle) * texelFetch(table, c + most, 0).rgb
    + (middle - low) * texelFetch(table, c + 1 - least, 0).rgb + low * texelFetch(table, c + 1, 0).rgb;
}`;

/** The source for a choice. @param {Choice} choice */
export const fragment = ({ curve, layer, compare, zebra, absolute, error, projection }) => `#version 300 es
precision highp float;
precision highp sampler2D;
in vec2 place;
out vec4 color;
uniform sampler2D picture;
uniform sampler2D truth;
uniform sampler2D truthMask;
uniform sampler2D depthMap;
uniform sampler2D alphaMap;
uniform sampler2D stopColors;
uniform sampler2D differenceColors;
uniform mat3 rec709;
uniform vec3 weights;
uniform float pictureScale;
uniform float truthScale;
uniform float gain;
const int curve = ${curve};
const int layer = ${layer};
const int compare = ${compare};
const bool zebra = ${zebra};
const bool absolute = ${absolute};
const int error = ${error};
uniform float wipe;
uniform bool showTruth;
uniform vec2 zebraRange;
uniform vec2 bands;
uniform mat3 firstFromOther;
uniform vec4 lens;
uniform mat3 axes;
uniform vec2 depthRange;
uniform float differenceHigh;
uniform float leastLuminance;
uniform float dotsPerPixel;

const mat3 ACES_IN = mat3(0.59719, 0.07600, 0.02840, 0.35458, 0.90834, 0.13383, 0.04823, 0.01566, 0.83777);
const mat3 ACES_OUT = mat3(1.60475, -0.10208, -0.00327, -0.53108, 1.10813, -0.07276, -0.07367, -0.00605, 1.07602);
const mat3 AGX_IN = mat3(0.84247906, 0.042328242, 0.042375655, 0.0784336, 0.87846864, 0.0784336, 0.079223745, 0.07916613, 0.879143);
const mat3 AGX_OUT = mat3(1.196879, -0.052896852, -0.052971636, -0.09802088, 1.1519031, -0.09804345, -0.09902974, -0.09896118, 1.1510737);

vec3 srgb(vec3 v) {
  v = max(v, 0.0);
  return mix(12.92 * v, 1.055 * pow(v, vec3(1.0 / 2.4)) - 0.055, greaterThan(v, vec3(0.0031308)));
}
vec3 aces(vec3 v) {
  v = ACES_IN * v;
  v = (v * (v + 0.0245786) - 0.000090537) / (v * (0.983729 * v + 0.432951) + 0.238081);
  return srgb(ACES_OUT * v);
}
vec3 agx(vec3 v) {
  vec3 x = clamp((log2(max(AGX_IN * v, 1.1754944e-38)) + 12.473931) / 16.5, 0.0, 1.0);
  vec3 y = -0.00232 + x * (0.1191 + x * (0.4298 + x * (-6.868 + x * (31.96 + x * (-40.14 + x * 15.5)))));
  return AGX_OUT * y;
}
${curve === TABLE ? TABLE_SHADER : ""}
vec3 display(vec3 radiance) {
${curve === TABLE ? "  return byTable(radiance * gain);" : ""}
  vec3 v = clamp(rec709 * radiance * gain, 0.0, 1e9);
  if (curve == 1) return log(1.0 + 5000.0 * v) / log(5001.0);
  if (curve == 2) return srgb(v / (1.0 + dot(v, vec3(0.2126, 0.7152, 0.0722))));
  if (curve == 3) return aces(v);
  if (curve == 4) return agx(v);
  return srgb(v);
}

${pointShader(projection)}
float depthAt(ivec2 pixel) {
  return texelFetch(depthMap, clamp(pixel, ivec2(0), textureSize(depthMap, 0) - 1), 0).r;
}
vec3 pointAt(ivec2 pixel) {
  return point((vec2(pixel) + 0.5 - lens.zw) / lens.xy, depthAt(pixel));
}
// The neighbour whose depth is nearer is more likely on the same surface.
vec3 edge(ivec2 pixel, ivec2 aside) {
  float here = depthAt(pixel);
  bool isAfter = abs(depthAt(pixel + aside) - here) < abs(depthAt(pixel - aside) - here);
  return isAfter ? pointAt(pixel + aside) - pointAt(pixel) : pointAt(pixel) - pointAt(pixel - aside);
}
vec3 normalAt(vec2 at) {
  ivec2 pixel = ivec2(at * vec2(textureSize(depthMap, 0)));
  if (!(depthAt(pixel) < 1e30)) return vec3(0.0);
  vec3 n = normalize(cross(edge(pixel, ivec2(1, 0)), edge(pixel, ivec2(0, 1))));
  n *= dot(n, pointAt(pixel)) > 0.0 ? -1.0 : 1.0;
  return 0.5 + 0.5 * (axes * vec3(n.x, -n.y, -n.z));
}

void main() {
  vec2 at = compare == 4 ? vec2(fract(2.0 * place.x), place.y) : place;
  vec3 shown = texture(picture, at).rgb * pictureScale;
  vec3 other = shown;
  if (compare != 0) other = firstFromOther * texture(truth, at).rgb * truthScale;
  if (compare == 2) {
    float a = max(dot(weights, shown), leastLuminance), b = max(dot(weights, other), leastLuminance);
    float found = error == 2 ? abs(a - b) / b : error == 1 ? 0.5 * log2(a / b) + 0.5 * differenceHigh : abs(log2(a / b));
    color = texture(differenceColors, vec2(clamp(found / differenceHigh, 0.0, 1.0), error == 1 ? 0.75 : 0.25));
    // What the mask hides is hatched.
    if (texture(truthMask, at).r < 0.5) color = vec4(vec3(mod((gl_FragCoord.x + gl_FragCoord.y) / dotsPerPixel, 8.0) < 4.0 ? 0.25 : 0.4), 1.0);
    return;
  }
  bool isTruth = compare == 1 ? place.x < wipe : compare == 4 ? place.x < 0.5 : (compare == 3 && showTruth);
  vec3 radiance = isTruth ? other : shown;
  vec3 rgb;
  float luminance = dot(weights, radiance);
  if (layer == 1) {
    float band = clamp(bands.x * log2(max(luminance, 1e-37)) + bands.y, 0.0, float(textureSize(stopColors, 0).x - 1));
    rgb = texelFetch(stopColors, ivec2(int(floor(band + 0.5)), absolute ? 1 : 0), 0).rgb;
  } else if (layer == 2) {
    float z = texture(depthMap, at).r;
    float t = (z - depthRange.x) / max(depthRange.y - depthRange.x, 1e-12);
    rgb = z < 1e30 ? vec3(1.0 - clamp(t, 0.0, 1.0)) : vec3(0.0);
  } else if (layer == 3) {
    rgb = vec3(texture(alphaMap, at).r);
  } else if (layer == 4) {
    rgb = normalAt(at);
  } else {
    rgb = display(radiance);
  }
  if (zebra && layer < 2) {
    float stripe = mod((gl_FragCoord.x + gl_FragCoord.y) / dotsPerPixel, 10.0);
    float back = mod((gl_FragCoord.x - gl_FragCoord.y) / dotsPerPixel, 10.0);
    if (luminance > zebraRange.y && stripe < 5.0) rgb = stripe < 2.5 ? vec3(0.0) : vec3(1.0);
    if (luminance < zebraRange.x && back < 3.0) rgb = vec3(0.35);
  }
  color = vec4(clamp(rgb, 0.0, 1.0), 1.0);
}`;
