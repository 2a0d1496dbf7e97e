// Pass `rasterize`: blends splats front to back. Twin: cpu/passes/rasterize.rs.
//
// A workgroup of 256 threads is a tile of 16x16 pixels, with one thread per pixel; entries are
// loaded 256 at a time into workgroup memory. A run of threads is a block of pixels, which looks
// only at the entries that have its bit, and stops by itself: its threads share one list, so they
// stay together whatever the size of a subgroup. In: each tile's entries front to back. Out:
// radiance [H*W,3] with the background; per pixel the number of its tile's entries up to and
// including the last that changed it; and, for training, transmittance and radiance of each pixel
// before every bucket but its tile's first, as long as the pixel is not finished.
//
// Where work is counted, the image holds numbers instead: entries that the pixel looked at, states
// that it stored.

@group(0) @binding(0) var<uniform> camera: Camera;
@group(0) @binding(1) var<storage, read> footprints: array<Footprint>;
@group(0) @binding(2) var<storage, read> ranges: array<vec2u>;
@group(0) @binding(3) var<storage, read> sorted_entries: array<u32>;
@group(0) @binding(4) var<storage, read> entries: array<Entry>;
@group(0) @binding(5) var<storage, read_write> image: array<f32>;
@group(0) @binding(6) var<storage, read_write> last_entries: array<u32>;
@group(0) @binding(7) var<storage, read_write> bucket_pixels: array<vec4f>;

const BATCH = 256u;

// Centre x, y, root_x, root_xy; root_y, log2_opacity, log2_threshold, red; green, blue.
var<workgroup> batch_a: array<vec4f, BATCH>;
var<workgroup> batch_b: array<vec4f, BATCH>;
var<workgroup> batch_c: array<vec2f, BATCH>;
var<workgroup> batch_blocks: array<u32, BATCH>;
// Which of a bucket's entries have a block's bit, [buckets, 4, BLOCKS]: each of the four words has
// the bits of a quarter of the bucket.
var<workgroup> quarters: array<u32, BATCH>;
var<workgroup> finished: atomic<u32>;
var<workgroup> all_finished: u32;

// Returns a thread's word of `quarters`.
fn quarter(local: u32) -> u32 {
    let block = local % BLOCKS;
    let first = (local / BLOCKS % 4u) * (BUCKET / 4u);
    let bucket = local / BUCKET * BUCKET;
    var word = 0u;
    for (var n = first; n < first + BUCKET / 4u; n++) {
        word |= ((batch_blocks[bucket + n] >> block) & 1u) << n;
    }
    return word;
}

// Returns which entries of a bucket of the batch have a block's bit.
fn entries_of_block(bucket: u32, block: u32) -> u32 {
    let at = bucket * BUCKET + block;
    return quarters[at] | quarters[at + BLOCKS] | quarters[at + 2u * BLOCKS] | quarters[at + 3u * BLOCKS];
}

@compute @workgroup_size(256)
fn rasterize(@builtin(workgroup_id) workgroup: vec3u, @builtin(local_invocation_index) local: u32) {
    let tile = group_index(workgroup);
    if (tile >= camera.tiles.x * camera.tiles.y) {
        return;
    }
    let at = vec2u(tile % camera.tiles.x, tile / camera.tiles.x) * TILE_PX + tile_pixel(local);
    let center = vec2f(at) + 0.5;
    let inside = all(at < camera.size_px);
    let range = ranges[tile];
    let slots = range.x / BUCKET + tile;
    let keeps_state = (camera.flags & FLAG_TRAINING) != 0u;
    var live = inside;
    var transmittance = 1.0;
    var radiance = vec3f(0.0);
    var last = 0u;
    var looks = 0u;
    var states = 0u;
    if (local == 0u) {
        atomicStore(&finished, 0u);
    }
    workgroupBarrier();
    if (!live) {
        atomicAdd(&finished, 1u);
    }
    for (var start = range.x; start < range.y; start += BATCH) {
        workgroupBarrier();
        if (local == 0u) {
            all_finished = select(0u, 1u, atomicLoad(&finished) == 256u);
        }
        if (workgroupUniformLoad(&all_finished) != 0u) {
            break;
        }
        var blocks = 0u;
        if (start + local < range.y) {
            let entry = entries[sorted_entries[start + local]];
            let f = footprints[entry.splat];
            batch_a[local] = vec4f(f.mean_px, f.root_x, f.root_xy);
            batch_b[local] = vec4f(f.root_y, f.log2_opacity, f.log2_threshold, f.red);
            batch_c[local] = vec2f(f.green, f.blue);
            blocks = entry.blocks;
        }
        batch_blocks[local] = blocks;
        workgroupBarrier();
        quarters[local] = quarter(local);
        workgroupBarrier();
        let len = min(BATCH, range.y - start);
        for (var first = 0u; live && first < len; first += BUCKET) {
            let before = start - range.x + first;
            if (keeps_state && before > 0u) {
                bucket_pixels[(slots + before / BUCKET) * TILE_PIXELS + local] = vec4f(radiance, transmittance);
                if (COUNTS) {
                    states++;
                }
            }
            var waiting = entries_of_block(first / BUCKET, local / BLOCK_PIXELS);
            while (live && waiting != 0u) {
                let n = first + firstTrailingBit(waiting);
                waiting &= waiting - 1u;
                if (COUNTS) {
                    looks++;
                }
                let a = batch_a[n];
                let b = batch_b[n];
                let seen = see(a.xy, vec3f(a.zw, b.x), b.y, center);
                if (seen.log2_alpha >= b.z) {
                    let alpha = min(exp2(seen.log2_alpha), camera.max_alpha);
                    let left = transmittance - alpha * transmittance;
                    if (left >= camera.min_transmittance) {
                        radiance += (alpha * transmittance) * vec3f(b.w, batch_c[n]);
                        transmittance = left;
                        last = start - range.x + n + 1u;
                    } else {
                        live = false;
                        atomicAdd(&finished, 1u);
                    }
                }
            }
        }
    }
    if (inside) {
        let pixel = at.y * camera.size_px.x + at.x;
        var shown = radiance + transmittance * camera.background.xyz;
        if (COUNTS) {
            shown = vec3f(f32(looks), f32(states), 0.0);
        }
        image[3u * pixel] = shown.x;
        image[3u * pixel + 1u] = shown.y;
        image[3u * pixel + 2u] = shown.z;
        last_entries[pixel] = last;
    }
}
