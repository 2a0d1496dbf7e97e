// Pass `project`: projects splats to ellipses on the screen, with pass `color` for visible splats.
// Twins: cpu/passes/project.rs, cpu/passes/project_rays.rs. What depends on the projection is in
// place.wgsl or place_rays.wgsl.
//
// One thread per splat of the shard. In: parameters [rows, stride], camera. Out, by the splat's
// number in the scene: `footprints`; `depth_keys`, ascending with depth, CULLED_KEY if it is
// culled; `places`: (unset, number of tiles touched). A splat is culled if it is nearer than
// `near`, nowhere above its alpha threshold, off the image, or not finite.

@group(0) @binding(0) var<uniform> camera: Camera;
@group(0) @binding(1) var<uniform> shard: Shard;
@group(0) @binding(2) var<storage, read> parameters: array<f32>;
@group(0) @binding(3) var<storage, read_write> footprints: array<Footprint>;
@group(0) @binding(4) var<storage, read_write> depth_keys: array<u32>;
@group(0) @binding(5) var<storage, read_write> places: array<vec2u>;

// The bits of positive floats have the order of the numbers. Counted from the near plane, and
// halved, 27 of them reach 32 octaves beyond it. A near plane closer than 2^-16 would leave none
// for common depths: then the octaves are those around 1, and all nearer depths share one key.
fn depth_key(depth: f32) -> u32 {
    let bits = bitcast<u32>(depth);
    let near = bitcast<u32>(max(camera.near, 1.52587890625e-5));
    return min((max(bits, near) - near) >> 1u, CULLED_KEY - 1u);
}

// Finaliser of MurmurHash3 (Appleby 2011). Twin: core/random.rs.
fn mix32(value: u32) -> u32 {
    var h = (value ^ (value >> 16u)) * 0x85ebca6bu;
    h = (h ^ (h >> 13u)) * 0xc2b2ae35u;
    return h ^ (h >> 16u);
}

// Reports whether the step draws a splat. Twin: core/engine/dropout.rs.
fn is_drawn(splat: u32) -> bool {
    let uniform_number = f32(mix32(mix32(splat + 0x9e3779b9u) ^ camera.dropout_seed) >> 8u) / 16777216.0;
    return uniform_number >= camera.dropout_rate;
}

@compute @workgroup_size(256)
fn project(@builtin(workgroup_id) workgroup: vec3u, @builtin(local_invocation_index) local: u32) {
    let i = group_index(workgroup) * 256u + local;
    if (i >= shard.len) {
        return;
    }
    let splat = shard.base + i;
    depth_keys[splat] = CULLED_KEY;
    places[splat] = vec2u(0u);
    if (!is_drawn(splat)) {
        return;
    }

    let p = project_splat(i);
    let opacity = p.opacity * p.compensation * p.filter_factor * camera.opacity_factor;
    // A splat whose largest possible footprint misses the image skips colour and the rest.
    let floor_alpha = min(camera.alpha_floor, camera.min_alpha);
    let widest = log(max(opacity / floor_alpha, 1.0)) * 2.0;
    if (!(p.at.depth >= camera.near && opacity >= floor_alpha && may_reach_image(p, widest))) {
        return;
    }

    let direction = view_direction(i);
    var basis = sh_basis(min(camera.active_degree, MAX_LIGHT_DEGREE), direction.xyz);
    let radiance = radiance_of(response(&basis, i));
    let brightest = max(radiance.x, max(radiance.y, radiance.z));
    // Cut-offs follow the radiance before the gains: a light of a mix is cut off as in its scene,
    // and an edited splat as it was trained.
    var gain = gain_of(i);
    if ((camera.flags & FLAG_EDIT_GAIN) != 0u) {
        gain *= parameter(ROW_EDIT_GAIN, i);
    }
    var threshold = camera.min_alpha;
    if ((camera.flags & FLAG_MIN_CONTRIBUTION) != 0u) {
        threshold = min(camera.min_contribution / max(brightest, 1e-30), camera.min_alpha);
    }
    threshold = max(threshold, camera.alpha_floor);
    let log2_opacity = log(max(opacity, 1e-30)) * LOG2_E;
    let log2_threshold = log(threshold) * LOG2_E;
    let root = inverse_root(p) * SQRT_HALF_LOG2_E;
    let finite = is_finite(root.x) && is_finite(root.y) && is_finite(root.z) && is_finite(brightest) && is_finite(brightest * gain);
    if (!(log2_opacity > log2_threshold && finite && root.x > 0.0 && root.z > 0.0)) {
        return;
    }
    var f: Footprint;
    f.log2_opacity = log2_opacity;
    f.log2_threshold = log2_threshold;
    f.red = radiance.x * gain;
    f.green = radiance.y * gain;
    f.blue = radiance.z * gain;
    if (!place(p, root, &f)) {
        return;
    }
    let area = touched_area(f, camera.tiles);
    var touched = 0u;
    for (var row = area.y; row < area.w; row++) {
        let columns = touched_columns(f, area, row, camera.tiles);
        touched += columns.y - columns.x;
    }
    footprints[splat] = f;
    places[splat] = vec2u(0u, touched);
    if (touched > 0u) {
        depth_keys[splat] = depth_key(p.at.depth);
    }
}
