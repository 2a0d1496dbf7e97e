/** Half floats to numbers, by a table of all 65536. */

const TABLE = new Float32Array(65536);
for (let i = 0; i < 65536; i++) {
  const [sign, exponent, mantissa] = [i & 0x8000 ? -1 : 1, (i >> 10) & 31, i & 1023];
  TABLE[i] =
    exponent === 0 ? sign * mantissa * 2 ** -24 : exponent === 31 ? (mantissa ? NaN : sign * Infinity) : sign * (1 + mantissa / 1024) * 2 ** (exponent - 15);
}

/** @param {number} bits @returns {number} */
export const fromHalf = (bits) => TABLE[bits];
