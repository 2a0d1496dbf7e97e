// How a bucket's splats meet their tile's pixels one after another, without a sum over threads: shared by `rasterize_backward` and `contribute`.
//
// A workgroup is a bucket, a thread one of its splats. Pixels pass along the threads like wagons along loaders: in step s, thread t works on
// pair number s - t of the tile's pixels, which thread t - 1, the splat in front, left in workgroup memory one step before. So every
// pixel meets the bucket's splats front to back, each thread sums up its own splat, and no two threads add to one number.

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

// Pixels that a thread works on between two barriers.
const WAGON = 2u;
const STEPS = TILE_PIXELS / WAGON + BUCKET - 1u;

var<workgroup> transmittances: array<f32, TILE_PIXELS>;
// The tile's entries up to and including the last that changed the pixel; 0 beyond the image.
var<workgroup> lasts: array<u32, TILE_PIXELS>;
