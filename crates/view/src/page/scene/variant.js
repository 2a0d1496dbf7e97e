/** The scene that a picture is of, and how its splats are drawn. */

/** @typedef {"blended" | "ellipsoids" | "centres"} Splats */
/**
 * `size` is in standard deviations for ellipsoids, a radius in pixels for centres; splats below
 * `opacity` are left out; `near` and `far` are depths in world units, 0 for none; `lens` is absent for a pinhole.
 * @typedef {{ scene: number, splats: Splats, size: number, opacity: number, near: number, far: number, lens?: Aperture }} Variant
 */
/** A lens: diameter and distance in focus in world units; the part of all samples that a picture is the mean of, and the number of parts. @typedef {{ diameter: number, focus: number, samples: number, part: [number, number] }} Aperture */

/** @type {readonly Splats[]} */
export const SPLATS = ["blended", "ellipsoids", "centres"];

/** Whether it is the first scene as it is rendered. @param {Variant} variant */
export const isPlain = ({ scene, splats, near, far, lens }) => scene === 0 && splats === "blended" && near <= 0 && far <= 0 && !lens;

/** Its parameters in an address. @param {Variant | undefined} variant */
export function parameters(variant) {
  if (!variant) return "";
  const { scene, splats, size, opacity, near, far, lens } = variant;
  const bodies = splats === "blended" ? "" : `&splats=${splats}&splat_size=${size}&splat_opacity=${opacity}`;
  return `${scene ? `&scene=${scene}` : ""}${bodies}${near > 0 ? `&near=${near}` : ""}${far > 0 ? `&far=${far}` : ""}${ofLens(lens)}`;
}

/** @param {Aperture | undefined} lens */
function ofLens(lens) {
  if (!lens) return "";
  const { diameter, focus, samples, part } = lens;
  return `&aperture=${diameter}&focus=${focus}&lens_samples=${samples}&lens_part=${part[0]}&lens_parts=${part[1]}`;
}

/** The variant with other samples of its lens, if it has one. @param {Variant} variant @param {Partial<Aperture>} change @returns {Variant} */
export const sampled = (variant, change) => (variant.lens ? { ...variant, lens: { ...variant.lens, ...change } } : variant);

/** The variant through a pinhole, whose coverage and depth those of a lens are. @param {Variant} variant @returns {Variant} */
export const sharp = ({ lens: _, ...variant }) => variant;
