// Pass `rasterize_backward`: computes the gradients of each entry, sums over its tile's pixels.
// Twin: cpu/passes/rasterize_backward.rs.
//
// In: buckets and the pixels' state before each of them, the image, `pixel_gradients`: gradient of
// the loss by radiance and (w) the number of entries up to the last that changed the pixel. Out, by
// entry as `bin_emit` numbered it (a splat's entries are neighbours): three vec4f, see
// `project_backward.wgsl`. Source of the division of work: Mallick et al. 2024, "Taming 3DGS",
// section on backpropagation by splats.
//
// With w_i = T_i alpha_i and S_i = sum over j > i of w_j c_j (background last), d alpha_i = T_i c_i
// - S_i / (1 - alpha_i), dotted with the pixel's gradient. S is computed from the front: the
// pixel's radiance minus what lies in front.

@group(0) @binding(6) var<storage, read> image: array<f32>;
@group(0) @binding(7) var<storage, read> pixel_gradients: array<vec4f>;
@group(0) @binding(8) var<storage, read_write> entry_gradients: array<vec4f>;

var<workgroup> gradients: array<vec3f, TILE_PIXELS>;
var<workgroup> behind: array<f32, TILE_PIXELS>;
var<workgroup> any_changed: atomic<u32>;
var<workgroup> is_changed: u32;

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
    let origin = vec2u(bucket.tile % camera.tiles.x, bucket.tile / camera.tiles.x) * TILE_PX;
    if (local == 0u) {
        atomicStore(&any_changed, 0u);
    }
    workgroupBarrier();
    for (var n = local; n < TILE_PIXELS; n += BUCKET) {
        let at = origin + tile_pixel(n);
        lasts[n] = 0u;
        if (all(at < camera.size_px)) {
            let pixel = at.y * camera.size_px.x + at.x;
            let gradient = pixel_gradients[pixel];
            // A pixel without a gradient has no effect, even if its values are not finite; masked
            // tiles cost nothing.
            let last = select(0u, u32(gradient.w), any(gradient.xyz != vec3f(0.0)));
            var state = vec4f(0.0, 0.0, 0.0, 1.0);
            if (last > bucket.before) {
                if (bucket.before > 0u) {
                    state = bucket_pixels[slot * TILE_PIXELS + n];
                }
                atomicOr(&any_changed, 1u);
            }
            let shown = vec3f(image[3u * pixel], image[3u * pixel + 1u], image[3u * pixel + 2u]);
            lasts[n] = last;
            gradients[n] = gradient.xyz;
            transmittances[n] = state.w;
            behind[n] = dot(shown - state.xyz, gradient.xyz);
        }
    }
    workgroupBarrier();
    if (local == 0u) {
        is_changed = atomicLoad(&any_changed);
    }
    var entry = 0u;
    var f: Footprint;
    if (local < bucket.len) {
        entry = sorted_entries[bucket.first + local];
        f = footprints[entry_splats[entry]];
    }
    let root = vec3f(f.root_x, f.root_xy, f.root_y);
    let color = vec3f(f.red, f.green, f.blue);
    let number = bucket.before + local;
    let with_absolute = (camera.flags & FLAG_ABSOLUTE) != 0u;
    var sum_g = vec3f(0.0);
    var sum_gg = vec3f(0.0);
    var sum_radiance = vec3f(0.0);
    var sum_absolute = vec2f(0.0);
    // Nothing behind the pixels' last entries has a gradient.
    let steps = select(0u, STEPS, workgroupUniformLoad(&is_changed) != 0u);
    for (var step = 0u; step < steps; step++) {
        // Negative numbers wrap to large ones.
        let wagon = step - local;
        if (wagon < TILE_PIXELS / WAGON && local < bucket.len) {
            for (var k = 0u; k < WAGON; k++) {
                let n = wagon * WAGON + k;
                if (number < lasts[n]) {
                    let seen = see(f.mean_px, root, f.log2_opacity, vec2f(origin + tile_pixel(n)) + 0.5);
                    if (seen.log2_alpha >= f.log2_threshold) {
                        let alpha = min(exp2(seen.log2_alpha), camera.max_alpha);
                        let transmittance = transmittances[n];
                        let gradient = gradients[n];
                        let weight = alpha * transmittance;
                        let shine = dot(color, gradient);
                        let rest = behind[n] - weight * shine;
                        transmittances[n] = transmittance - weight;
                        behind[n] = rest;
                        // Where alpha is capped it has no gradient.
                        let d_alpha = transmittance * shine - rest / (1.0 - alpha);
                        let g = select(0.0, alpha * d_alpha, alpha < camera.max_alpha);
                        let gu = g * seen.u;
                        let gv = g * seen.v;
                        let weight_of_center = facing(seen);
                        sum_g += vec3f(g, weight_of_center * gu, weight_of_center * gv);
                        sum_gg += vec3f(gu * seen.u, gu * seen.v, gv * seen.v);
                        sum_radiance += weight * gradient;
                        if (with_absolute) {
                            sum_absolute += abs(vec2f(gu, root.y * gu + root.z * gv));
                        }
                    }
                }
            }
        }
        workgroupBarrier();
    }
    if (local < bucket.len) {
        entry_gradients[3u * entry] = vec4f(sum_g, sum_gg.x);
        entry_gradients[3u * entry + 1u] = vec4f(sum_gg.yz, sum_radiance.xy);
        entry_gradients[3u * entry + 2u] = vec4f(sum_radiance.z, sum_absolute, 0.0);
    }
}
