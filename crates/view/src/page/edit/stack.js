/**
 * The stack of edits: entries that the page shows, the text that `luxel edit` and the server read,
 * and the command line that does the same. An entry that is switched off is in neither.
 */

/** A map of `luxel edit`, and its value as text. @typedef {{ name: string, value: string }} Op */
/**
 * What an entry does: maps on light, deleted splats, deleted floaters, new axes.
 * @typedef {{ kind: "light" | "delete" | "floaters" | "axes", on: boolean, where: string, maps: Op[], up: string, origin: string }} Entry
 */

/** @param {Partial<Entry>} fields @returns {Entry} */
export const entry = (fields) => ({ kind: "light", on: true, where: "all", maps: [], up: "", origin: "", ...fields });

/** Statements of a text; quotes protect what is between. @param {string} text @returns {string[]} */
function statements(text) {
  const found = [""];
  let quote = "";
  for (const character of text) {
    if (quote ? character === quote : character === '"' || character === "'") quote = quote ? "" : character;
    if (character === ";" && !quote) found.push("");
    else found[found.length - 1] += character;
  }
  return found.map((statement) => statement.trim()).filter(Boolean);
}

/** Entries of a text, as far as it can be read; what is wrong is for the server to say. @param {string} text @returns {Entry[]} */
export function parse(text) {
  /** @type {Entry[]} */
  const entries = [];
  let current = /** @type {Entry | null} */ (null);
  for (const statement of statements(text)) {
    const [, name, value] = /** @type {RegExpMatchArray} */ (statement.match(/^(\S+)\s*([^]*)$/));
    if (name === "where") entries.push((current = entry({ where: value })));
    else if (name === "delete") entries.push(entry({ kind: "delete", where: value }));
    else if (name === "floaters") entries.push(entry({ kind: "floaters" }));
    else if (name === "up" || name === "origin") {
      let axes = entries.find((known) => known.kind === "axes");
      if (!axes) entries.push((axes = entry({ kind: "axes" })));
      axes[name] = value;
    } else {
      if (!current) entries.push((current = entry({})));
      current.maps.push({ name, value });
    }
  }
  return entries;
}

/** Pairs of statement and value of the entries that are on. @param {Entry[]} entries @returns {Op[]} */
function pairs(entries) {
  /** @type {Op[]} */
  const found = [];
  const on = entries.filter((entry) => entry.on);
  for (const { kind, where, maps } of on) if (kind === "light" && maps.length) found.push({ name: "where", value: where }, ...maps);
  // One option: deletions are of the scene as it is, together.
  const deleted = on.filter(({ kind }) => kind === "delete").map(({ where }) => where);
  if (deleted.length) found.push({ name: "delete", value: deleted.length > 1 ? deleted.map((where) => (/ (and|or) /.test(where) ? `(${where})` : where)).join(" or ") : deleted[0] });
  if (on.some(({ kind }) => kind === "floaters")) found.push({ name: "floaters", value: "" });
  for (const { kind, up, origin } of on) {
    if (kind !== "axes") continue;
    if (up) found.push({ name: "up", value: up });
    if (origin) found.push({ name: "origin", value: origin });
  }
  // Without a selection before it, a map is of all splats.
  if (found[0]?.name === "where" && found[0].value === "all") found.shift();
  return found;
}

/** @param {Entry[]} entries */
export const format = (entries) => pairs(entries).map(({ name, value }) => (value ? `${name} ${value}` : name)).join("; ");

/** A word of a POSIX shell. @param {string} word */
const quoted = (word) => (/^[\w@%+=:,./-]+$/.test(word) ? word : `'${word.replaceAll("'", "'\\''")}'`);

/** The command that does the same. @param {Entry[]} entries @param {string} path @param {string} output */
export function command(entries, path, output) {
  const options = pairs(entries).map(({ name, value }) => (value ? `--${name}${value.startsWith("-") ? "=" : " "}${quoted(value)}` : `--${name}`));
  return ["luxel edit", quoted(path.startsWith("-") ? `./${path}` : path), ...options, "-o", quoted(output)].join(" ");
}
