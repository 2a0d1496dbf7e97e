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

var<workgroup> painted: array<f32, BLOCK_PIXELS>;
var<workgroup> part_sums: array<vec3f, BUCKET>;

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
    let corner = vec2u(bucket.tile % camera.tiles.x, bucket.tile / camera.tiles.x) * TILE_PX;
    var counts = vec2u(0u);
    for (var block = 0u; block < BLOCKS; block++) {
        if (all(corner + tile_pixel(block * BLOCK_PIXELS + local) < camera.size_px)) {
            counts += count_of_block(block, BUCKET);
        }
    }
    let entry = stage(bucket, local, counts);
    var sums = vec3f(0.0);
    for (var block = 0u; block < BLOCKS; block++) {
        var waiting = workgroupUniformLoad(&waiting_of_block[block]);
        if (waiting == 0u) {
            continue;
        }
        let at = corner + tile_pixel(block * BLOCK_PIXELS + local);
        let center = vec2f(at) + 0.5;
        let inside = all(at < camera.size_px);
        var last = 0u;
        var transmittance = 1.0;
        painted[local] = 0.0;
        if (inside) {
            last = last_entries[at.y * camera.size_px.x + at.x];
            painted[local] = mask[at.y / camera.samples * (camera.size_px.x / camera.samples) + at.x / camera.samples];
            if (bucket.before > 0u && last > bucket.before) {
                transmittance = bucket_pixels[slot * TILE_PIXELS + block * BLOCK_PIXELS + local].w;
            }
        }
        while (waiting != 0u) {
            let rows = next_rows(waiting);
            waiting &= ~rows;
            let span = span_of(rows);
            var row = 0u;
            for (var left = rows; left != 0u; left &= left - 1u) {
                let n = firstTrailingBit(left);
                let a = splats_a[n];
                let b = splats_b[n];
                let seen = see(a.xy, vec3f(a.zw, b.x), b.y, center);
                // Blending weight, alpha.
                var pair = vec2f(0.0);
                if (inside && seen.log2_alpha >= b.z) {
                    pair.y = min(exp2(seen.log2_alpha), camera.max_alpha);
                    if (bucket.before + n < last) {
                        pair.x = pair.y * transmittance;
                        transmittance -= pair.x;
                    }
                }
                pairs[row * ROW_STRIDE + local] = pair;
                row++;
            }
            workgroupBarrier();
            if (local % span < row) {
                var part = vec3f(0.0);
                for (var pixel = local / span * span; pixel < (local / span + 1u) * span; pixel++) {
                    let pair = pairs[local % span * ROW_STRIDE + pixel];
                    part += vec3f(pair.x * painted[pixel], pair);
                }
                part_sums[local] = part;
            }
            workgroupBarrier();
            if (((rows >> local) & 1u) != 0u) {
                for (var part = row_of(rows, local); part < BUCKET; part += span) {
                    sums += part_sums[part];
                }
            }
        }
    }
    if (local < bucket.len) {
        let b = splats_b[local];
        entry_sums[entry] = vec4f(sums, sums.x * max(b.w, max(splats_c[local].x, splats_c[local].y)));
    }
}
