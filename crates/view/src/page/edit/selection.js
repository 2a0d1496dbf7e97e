/** Selections as a list of tests with one word between them, as far as a text has that form. */

/** A test, whether it is negated, and the width of its soft edge. @typedef {{ not: boolean, body: string, soft: string }} Test */
/** @typedef {{ join: "and" | "or", tests: Test[] }} Tests */

/** Parts of a text between the words and, or outside of quotes and parentheses; null where a selection is nested. @param {string} text @returns {Tests | null} */
export function parseTests(text) {
  const words = [""];
  /** @type {string[]} */ const joins = [];
  let [quote, depth] = ["", 0];
  for (let i = 0; i < text.length; i++) {
    const character = text[i];
    if (quote ? character === quote : character === '"' || character === "'") quote = quote ? "" : character;
    else if (!quote) depth += character === "(" ? 1 : character === ")" ? -1 : 0;
    const word = !quote && depth === 0 && text.slice(i).match(/^\s(and|or)\s/);
    if (word) {
      joins.push(word[1]);
      words.push("");
      i += word[0].length - 1;
    } else words[words.length - 1] += character;
  }
  if (new Set(joins).size > 1) return null;
  const tests = words.map((word) => {
    const [, not, rest] = /** @type {RegExpMatchArray} */ (word.trim().match(/^(not\s+)?([^]*)$/));
    const soft = rest.match(/^([^]*?)\s*~\s*([-+.\deE]+)$/);
    return { not: Boolean(not), body: soft ? soft[1] : rest, soft: soft ? soft[2] : "" };
  });
  if (tests.some(({ body }) => !body || body.startsWith("(") || body.startsWith("not "))) return null;
  return { join: joins[0] === "or" ? "or" : "and", tests: tests.filter(({ body, not }) => body !== "all" || not) };
}

/** @param {Tests} tests */
export function formatTests({ join, tests }) {
  const one = (/** @type {Test} */ { not, body, soft }) => `${not ? "not " : ""}${body}${Number(soft) > 0 ? ` ~${soft}` : ""}`;
  return tests.length ? tests.map(one).join(` ${join} `) : "all";
}

/** A number of few digits. @param {number} value */
export const short = (value) => String(Number(value.toPrecision(4)));

/** Numbers of a shape's test; null for another test. @param {string} body @param {"box" | "sphere"} name */
export function shape(body, name) {
  const found = body.match(/^(box|sphere)\s*\(([^)]*)\)$/);
  const numbers = found?.[1] === name ? found[2].split(",").map(Number) : [];
  return numbers.length === (name === "box" ? 6 : 4) && numbers.every(Number.isFinite) ? numbers : null;
}

/** @param {"box" | "sphere"} name @param {number[]} numbers */
export const shapeText = (name, numbers) => `${name}(${numbers.map((value) => Number(value.toPrecision(6))).join(",")})`;

/** Hue in degrees of linear Rec.709, as selections have it; null for grey. @param {number[]} rgb */
export function hueOf(rgb) {
  const [r, g, b] = rgb.map((value) => Math.max(0, value));
  const [low, high] = [Math.min(r, g, b), Math.max(r, g, b)];
  const span = high - low;
  if (span <= 1e-6 * high) return null;
  const sixths = high === r ? ((g - b) / span + 6) % 6 : high === g ? (b - r) / span + 2 : (r - g) / span + 4;
  return 60 * sixths;
}
