/** The scene as the server describes it, and the steering of a training. */

import { checked } from "./server.js";

/** @typedef {import("../math/vectors.js").Vec3} Vec3 */
/**
 * A camera of the data set: pose and lens as `transforms.json` has them. Without a model it is a pinhole.
 * @typedef {{ name: string, split: string, has_ground_truth: boolean, transform_matrix: number[][],
 *   fl_x: number, fl_y: number, cx: number, cy: number, w: number, h: number,
 *   camera_model?: string, k1?: number, k2?: number, k3?: number, k4?: number, fisheye_crop_radius?: number }} ViewCamera
 */
/** @typedef {{ done: number, total: number, is_paused: boolean, is_finished: boolean, records: number }} Training */
/** The newest state; `cameras` grows whenever a camera has moved. @typedef {{ version: number, splats: number, cameras: number, training: Training | null }} Status */
/**
 * @typedef {{ name: string, path: string, splats: number, bounds: [Vec3, Vec3], inner_bounds: [Vec3, Vec3], color_space: string, is_display: boolean,
 *   rec709_from_scene: number[][], luminance_weights: Vec3, radiance_scale: number, up: Vec3, edits: string[],
 *   cd_m2_per_unit: number | null, world_from_local: Frame3, others: OtherScene[], metres_per_unit?: number | null, display?: DisplayTable | null, mesh?: { world_from_file: number[][] } | null,
 *   version: number, cameras_version: number, training: Training | null, download_bytes: number | null, lights: number, cameras: ViewCamera[], luxel_version: string }} Scene
 */
/** From the coordinates of the splats to the world: turned by the rows of `rotation`, multiplied, moved. @typedef {{ rotation: number[][], scale: number, translation: Vec3 }} Frame3 */
/** A display of OpenColorIO: code values as half floats, once they are there, at `side`^3 radiances whose logarithm is even in the range. @typedef {{ display: string, view: string, side: number, range_log2: [number, number], values?: Uint16Array }} DisplayTable */
/** A scene that is compared with. @typedef {{ name: string, splats: number, color_space: string, first_from_scene: number[][], luminance_weights: Vec3, radiance_scale: number }} OtherScene */
/** @typedef {{ width: number, height: number, scale: number, rgb: boolean, alpha: boolean, depth: boolean, version: number, seconds: number }} Head */
/**
 * A picture: half floats of radiance (of a scene of display colours: of their light) divided by `head.scale`, coverage, depth.
 * @typedef {{ head: Head, rgb: Uint16Array, alpha: Uint16Array | null, depth: Float32Array | null }} Frame
 */

/** @param {number} from @returns {Promise<any[]>} */
export const fetchHistory = async (from) => (await checked(await fetch(`/api/history?from=${from}`))).json();

/** The cameras as they are now. @returns {Promise<ViewCamera[]>} */
export const fetchCameras = async () => (await checked(await fetch("/api/cameras"))).json();

/** @param {string} wish */
export const steer = async (wish) => {
  await checked(await fetch(`/api/training/${wish}`, { method: "POST" }));
};
