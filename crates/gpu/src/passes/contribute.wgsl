// Pass `contribute`: computes what each splat contributes to an image. It is not part of training.
// Twin: cpu/passes/contribute.rs.
//
// In: the inputs of `rasterize_backward`, and a mask [H*W]. Out, by entry: sums over its tile's
// pixels of its blending weight times the mask, of its blending weight, of its alpha, behind
// finished pixels too, and of the masked weight times its brightest channel. `contribute_sum` adds
// up each splat's entries.

@group(0) @binding(6) var<storage, read> last_entries: array<u32>;
@group(0) @binding(7) var<storage, read> mask: array<f32>;
@group(0) @binding(8) var<storage, read_write> entry_sums: array<vec4f>;

var<workgroup> painted: array<f32, TILE_PIXELS>;

@compute @workgroup_size(BUCKET)
fn contribute(@builtin(workgroup_id) workgroup: vec3u, @builtin(local_invocation_index) local: u32) {
    let slot = group_index(workgroup);
    if (slot >= buckets.count) {
        return;
    }
    let bucket = buckets.slots[slot];
    if (bucket.len == 0u) {
        return;
    }
    let origin = vec2u(bucket.tile % camera.tiles.x, bucket.tile / camera.tiles.x) * TILE_PX;
    for (var n = local; n < TILE_PIXELS; n += BUCKET) {
        let at = origin + tile_pixel(n);
        // One more than the number, to distinguish pixels beyond the image from pixels that no
        // entry changed.
        var last = 0u;
        if (all(at < camera.size_px)) {
            let pixel = at.y * camera.size_px.x + at.x;
            last = last_entries[pixel] + 1u;
            painted[n] = mask[at.y / camera.samples * (camera.size_px.x / camera.samples) + at.x / camera.samples];
            transmittances[n] = 1.0;
            if (bucket.before > 0u && last > bucket.before + 1u) {
                transmittances[n] = bucket_pixels[slot * TILE_PIXELS + n].w;
            }
        }
        lasts[n] = last;
    }
    workgroupBarrier();
    var entry = 0u;
    var f: Footprint;
    if (local < bucket.len) {
        entry = sorted_entries[bucket.first + local];
        f = footprints[entry_splats[entry]];
    }
    let root = vec3f(f.root_x, f.root_xy, f.root_y);
    let number = bucket.before + local;
    var sums = vec3f(0.0);
    for (var step = 0u; step < STEPS; step++) {
        // Negative numbers wrap to large ones.
        let wagon = step - local;
        if (wagon < TILE_PIXELS / WAGON && local < bucket.len) {
            for (var k = 0u; k < WAGON; k++) {
                let n = wagon * WAGON + k;
                let seen = see(f.mean_px, root, f.log2_opacity, vec2f(origin + tile_pixel(n)) + 0.5);
                if (lasts[n] > 0u && seen.log2_alpha >= f.log2_threshold) {
                    let alpha = min(exp2(seen.log2_alpha), camera.max_alpha);
                    var weight = 0.0;
                    if (number + 1u < lasts[n]) {
                        weight = alpha * transmittances[n];
                        transmittances[n] -= weight;
                    }
                    sums += vec3f(weight * painted[n], weight, alpha);
                }
            }
        }
        workgroupBarrier();
    }
    if (local < bucket.len) {
        entry_sums[entry] = vec4f(sums, sums.x * max(f.red, max(f.green, f.blue)));
    }
}
