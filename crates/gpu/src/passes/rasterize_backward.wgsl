// Pass `rasterize_backward`: computes the gradients of each entry, sums over its tile's pixels.
// Twin: cpu/passes/rasterize_backward.rs.
//
// In: buckets and the pixels' state before each of them, the image, `pixel_gradients`: gradient of
// the loss by radiance and (w) the number of entries up to the last that changed the pixel. Out, by
// entry as `bin_emit` numbered it (a splat's entries are neighbours): three vec4f, see
// `project_backward.wgsl`. Source of the division into buckets: Mallick et al. 2024, "Taming 3DGS",
// section on backpropagation by splats; of the phases: `unwind.wgsl`.
//
// With w_i = T_i alpha_i and S_i = sum over j > i of w_j c_j (background last), d alpha_i = T_i c_i
// - S_i / (1 - alpha_i), dotted with the pixel's gradient. S is computed from the front: the
// pixel's radiance minus what lies in front.
//
// Where work is counted, the last number of an entry is a sum of numbers that do not overlap: pairs
// with pixels that it changed; 2^9 times the blocks that looked at it; and of the bucket's first
// entry, 2^13 times the steps of phase 2, in eights, and 2^19 times how often both phases ran.

@group(0) @binding(6) var<storage, read> image: array<f32>;
@group(0) @binding(7) var<storage, read> pixel_gradients: array<vec4f>;
@group(0) @binding(8) var<storage, read_write> entry_gradients: array<vec4f>;

// Sums over the pixels of an entry.
struct Sums {
    // alpha times the gradient by alpha, and its products with u and v.
    g: vec3f,
    gg: vec3f,
    radiance: vec3f,
    absolute: vec2f,
    // Pairs that were added, if they are counted.
    count: f32,
}

const NO_SUMS = Sums(vec3f(0.0), vec3f(0.0), vec3f(0.0), vec2f(0.0), 0.0);
const SUMS = 11u + u32(COUNTS);

// Gradients of the block's pixels, [channels, pixels].
var<workgroup> gradients: array<f32, 3u * BLOCK_PIXELS>;
// Sums of parts, [SUMS, threads].
var<workgroup> part_sums: array<f32, SUMS * BUCKET>;

fn pixel_number(at: vec2u) -> u32 {
    return at.y * camera.size_px.x + at.x;
}

// Returns the number of entries up to the last that changed a pixel. A pixel without a gradient has
// no effect, even if its values are not finite; masked tiles cost nothing.
fn last_of(gradient: vec4f) -> u32 {
    return select(0u, u32(gradient.w), any(gradient.xyz != vec3f(0.0)));
}

// Phase 1 for a splat and a pixel: returns alpha times the gradient by alpha, and the blending
// weight; zero if the splat did not change the pixel.
fn differentiate(n: u32, center: vec2f, gradient: vec3f, transmittance: ptr<function, f32>, behind: ptr<function, f32>) -> vec2f {
    let a = splats_a[n];
    let b = splats_b[n];
    let seen = see(a.xy, vec3f(a.zw, b.x), b.y, center);
    if (seen.log2_alpha < b.z) {
        return vec2f(0.0);
    }
    let alpha = min(exp2(seen.log2_alpha), camera.max_alpha);
    let weight = alpha * *transmittance;
    let shine = dot(vec3f(b.w, splats_c[n]), gradient);
    let rest = *behind - weight * shine;
    let d_alpha = *transmittance * shine - rest / (1.0 - alpha);
    *transmittance -= weight;
    *behind = rest;
    // Where alpha is capped it has no gradient.
    return vec2f(select(0.0, alpha * d_alpha, alpha < camera.max_alpha), weight);
}

// Phase 2: the sums of a row over `span` of the block's pixels, which begins at `corner`.
fn sum_row(row: u32, n: u32, first: u32, span: u32, corner: vec2u, block: u32) -> Sums {
    let a = splats_a[n];
    let b = splats_b[n];
    let root = vec3f(a.zw, b.x);
    let with_absolute = (camera.flags & FLAG_ABSOLUTE) != 0u;
    var sums = NO_SUMS;
    for (var pixel = first; pixel < first + span; pixel++) {
        let pair = pairs[row * ROW_STRIDE + pixel];
        // Far from a splat its offsets may be beyond the numbers.
        if (any(pair != vec2f(0.0))) {
            let seen = see(a.xy, root, b.y, vec2f(corner + tile_pixel(block * BLOCK_PIXELS + pixel)) + 0.5);
            let gu = pair.x * seen.u;
            let gv = pair.x * seen.v;
            let weight_of_center = facing(seen);
            sums.g += vec3f(pair.x, weight_of_center * gu, weight_of_center * gv);
            sums.gg += vec3f(gu * seen.u, gu * seen.v, gv * seen.v);
            sums.radiance += pair.y * vec3f(gradients[pixel], gradients[BLOCK_PIXELS + pixel], gradients[2u * BLOCK_PIXELS + pixel]);
            if (COUNTS) {
                sums.count += 1.0;
            }
            if (with_absolute) {
                sums.absolute += abs(vec2f(gu, root.y * gu + root.z * gv));
            }
        }
    }
    return sums;
}

fn store_part(local: u32, sums: Sums) {
    part_sums[local] = sums.g.x;
    part_sums[BUCKET + local] = sums.g.y;
    part_sums[2u * BUCKET + local] = sums.g.z;
    part_sums[3u * BUCKET + local] = sums.gg.x;
    part_sums[4u * BUCKET + local] = sums.gg.y;
    part_sums[5u * BUCKET + local] = sums.gg.z;
    part_sums[6u * BUCKET + local] = sums.radiance.x;
    part_sums[7u * BUCKET + local] = sums.radiance.y;
    part_sums[8u * BUCKET + local] = sums.radiance.z;
    if ((camera.flags & FLAG_ABSOLUTE) != 0u) {
        part_sums[9u * BUCKET + local] = sums.absolute.x;
        part_sums[10u * BUCKET + local] = sums.absolute.y;
    }
    if (COUNTS) {
        part_sums[(SUMS - 1u) * BUCKET + local] = sums.count;
    }
}

// Returns three of the sums that a thread stored.
fn three_of(first: u32, local: u32) -> vec3f {
    let at = first * BUCKET + local;
    return vec3f(part_sums[at], part_sums[at + BUCKET], part_sums[at + 2u * BUCKET]);
}

fn add_part(sums: ptr<function, Sums>, local: u32) {
    (*sums).g += three_of(0u, local);
    (*sums).gg += three_of(3u, local);
    (*sums).radiance += three_of(6u, local);
    if ((camera.flags & FLAG_ABSOLUTE) != 0u) {
        (*sums).absolute += vec2f(part_sums[9u * BUCKET + local], part_sums[10u * BUCKET + local]);
    }
    if (COUNTS) {
        (*sums).count += part_sums[(SUMS - 1u) * BUCKET + local];
    }
}

@compute @workgroup_size(BUCKET)
fn rasterize_backward(@builtin(workgroup_id) workgroup: vec3u, @builtin(local_invocation_index) local: u32) {
    let slot = group_index(workgroup);
    if (slot >= buckets.count) {
        return;
    }
    let bucket = buckets.slots[slot];
    if (bucket.len == 0u) {
        return;
    }
    let corner = vec2u(bucket.tile % camera.tiles.x, bucket.tile / camera.tiles.x) * TILE_PX;
    // Nothing behind the pixels' last entries has a gradient.
    var counts = vec2u(0u);
    for (var block = 0u; block < BLOCKS; block++) {
        let at = corner + tile_pixel(block * BLOCK_PIXELS + local);
        if (all(at < camera.size_px)) {
            let last = last_of(pixel_gradients[pixel_number(at)]);
            counts += count_of_block(block, max(last, bucket.before) - bucket.before);
        }
    }
    let entry = stage(bucket, local, counts);
    var sums = NO_SUMS;
    for (var block = 0u; block < BLOCKS; block++) {
        var waiting = workgroupUniformLoad(&waiting_of_block[block]);
        if (waiting == 0u) {
            continue;
        }
        let at = corner + tile_pixel(block * BLOCK_PIXELS + local);
        let center = vec2f(at) + 0.5;
        var last = 0u;
        var gradient = vec3f(0.0);
        var transmittance = 1.0;
        var behind = 0.0;
        if (all(at < camera.size_px)) {
            let pixel = pixel_number(at);
            let by_pixel = pixel_gradients[pixel];
            last = last_of(by_pixel);
            if (last > bucket.before) {
                gradient = by_pixel.xyz;
                var state = vec4f(0.0, 0.0, 0.0, 1.0);
                if (bucket.before > 0u) {
                    state = bucket_pixels[slot * TILE_PIXELS + block * BLOCK_PIXELS + local];
                }
                let shown = vec3f(image[3u * pixel], image[3u * pixel + 1u], image[3u * pixel + 2u]);
                transmittance = state.w;
                behind = dot(shown - state.xyz, gradient);
            }
        }
        gradients[local] = gradient.x;
        gradients[BLOCK_PIXELS + local] = gradient.y;
        gradients[2u * BLOCK_PIXELS + local] = gradient.z;
        while (waiting != 0u) {
            let rows = next_rows(waiting);
            waiting &= ~rows;
            let span = span_of(rows);
            var number = 0u;
            var row = 0u;
            for (var left = rows; left != 0u; left &= left - 1u) {
                let n = firstTrailingBit(left);
                // The entry that this thread sums in phase 2.
                number = select(number, n, row == local % span);
                var pair = vec2f(0.0);
                if (bucket.before + n < last) {
                    pair = differentiate(n, center, gradient, &transmittance, &behind);
                }
                pairs[row * ROW_STRIDE + local] = pair;
                row++;
            }
            workgroupBarrier();
            if (local % span < row) {
                store_part(local, sum_row(local % span, number, local / span * span, span, corner, block));
            }
            workgroupBarrier();
            if (COUNTS) {
                sums.count += f32((((rows >> local) & 1u) << 9u) + select(0u, (span / 8u << 13u) + (1u << 19u), local == 0u));
            }
            if (((rows >> local) & 1u) != 0u) {
                for (var part = row_of(rows, local); part < BUCKET; part += span) {
                    add_part(&sums, part);
                }
            }
        }
    }
    if (local < bucket.len) {
        entry_gradients[3u * entry] = vec4f(sums.g, sums.gg.x);
        entry_gradients[3u * entry + 1u] = vec4f(sums.gg.yz, sums.radiance.xy);
        entry_gradients[3u * entry + 2u] = vec4f(sums.radiance.z, sums.absolute, sums.count);
    }
}
