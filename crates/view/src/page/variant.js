/** The scene that a picture is of, and how its splats are drawn. */

/** @typedef {"blended" | "ellipsoids" | "centres"} Splats */
/**
 * `size` is in standard deviations for ellipsoids, a radius in pixels for centres; splats below
 * `opacity` are left out; `near` and `far` are depths in world units, 0 for none.
 * @typedef {{ scene: number, splats: Splats, size: number, opacity: number, near: number, far: number }} Variant
 */

/** @type {readonly Splats[]} */
export const SPLATS = ["blended", "ellipsoids", "centres"];

/** Whether it is the first scene as it is rendered. @param {Variant} variant */
export const isPlain = ({ scene, splats, near, far }) => scene === 0 && splats === "blended" && near <= 0 && far <= 0;

/** Its parameters in an address. @param {Variant | undefined} variant */
export function parameters(variant) {
  if (!variant) return "";
  const { scene, splats, size, opacity, near, far } = variant;
  const bodies = splats === "blended" ? "" : `&splats=${splats}&splat_size=${size}&splat_opacity=${opacity}`;
  return `${scene ? `&scene=${scene}` : ""}${bodies}${near > 0 ? `&near=${near}` : ""}${far > 0 ? `&far=${far}` : ""}`;
}
