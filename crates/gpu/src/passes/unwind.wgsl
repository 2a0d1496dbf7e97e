// Iteration of a bucket's splats over their tile's pixels, without sums over threads: shared by
// `rasterize_backward` and `contribute`.
//
// A workgroup is a bucket, and each thread one of its splats. Pixels move along the threads as in a
// pipeline: in step s, thread t works on pair number s - t of the tile's pixels, which thread t -
// 1, the splat in front, stored in workgroup memory one step before. So every pixel is processed by
// the bucket's splats front to back, each thread sums up its own splat, and no two threads add to
// the same number.

@group(0) @binding(0) var<uniform> camera: Camera;
@group(0) @binding(1) var<storage, read> footprints: array<Footprint>;
@group(0) @binding(2) var<storage, read> buckets: Buckets;
@group(0) @binding(3) var<storage, read> sorted_entries: array<u32>;
@group(0) @binding(4) var<storage, read> entry_splats: array<u32>;
@group(0) @binding(5) var<storage, read> bucket_pixels: array<vec4f>;

struct Bucket {
    tile: u32,
    first: u32,
    len: u32,
    before: u32,
}

struct Buckets {
    count: u32,
    padding: array<u32, 3>,
    slots: array<Bucket>,
}

// Pixels that a thread processes between two barriers.
const WAGON = 2u;
const STEPS = TILE_PIXELS / WAGON + BUCKET - 1u;

var<workgroup> transmittances: array<f32, TILE_PIXELS>;
// Number of the tile's entries up to and including the last that changed the pixel; 0 beyond the
// image.
var<workgroup> lasts: array<u32, TILE_PIXELS>;
