/** Half floats to numbers and back, by tables of all 65536. */

const TABLE = new Float32Array(65536);
for (let i = 0; i < 65536; i++) {
  const [sign, exponent, mantissa] = [i & 0x8000 ? -1 : 1, (i >> 10) & 31, i & 1023];
  TABLE[i] =
    exponent === 0 ? sign * mantissa * 2 ** -24 : exponent === 31 ? (mantissa ? NaN : sign * Infinity) : sign * (1 + mantissa / 1024) * 2 ** (exponent - 15);
}

/** @param {number} bits @returns {number} */
export const fromHalf = (bits) => TABLE[bits];

/** The half float nearest to a number of 0 or more; those beyond the largest become that. @param {number} value @returns {number} */
export function toHalf(value) {
  if (!(value > 0)) return 0;
  if (value >= 65504) return 0x7bff;
  const exponent = Math.max(-14, Math.floor(Math.log2(value)));
  // A mantissa that is rounded up to 1024 carries into the exponent, as it should.
  return Math.round(value * 2 ** (10 - exponent)) + (exponent + 14) * 1024;
}

/** Light of sRGB's codes, continued above 1 (IEC 61966-2-1). @param {number} code */
const lightOf = (code) => (code <= 0.04045 ? code / 12.92 : ((code + 0.055) / 1.055) ** 2.4);

/** The last table of light, and the scale that it is for. @type {{ scale: number, table: Uint16Array } | null} */
let lights = null;

/** Half floats of light for those of a display's colours, both times `scale`. @param {Uint16Array} codes @param {number} scale @returns {Uint16Array} */
export function decoded(codes, scale) {
  if (lights?.scale !== scale) lights = { scale, table: Uint16Array.from(TABLE, (code) => toHalf(lightOf(code * scale) / scale)) };
  const { table } = lights;
  return codes.map((code) => table[code]);
}
