// Adds up a splat's entries, in the order of its tiles: the second part of `contribute`.

@group(0) @binding(0) var<uniform> camera: Camera;
@group(0) @binding(1) var<storage, read> state: State;
@group(0) @binding(2) var<storage, read> places: array<vec2u>;
@group(0) @binding(3) var<storage, read> entry_sums: array<vec4f>;
@group(0) @binding(4) var<storage, read_write> splat_sums: array<vec4f>;

@compute @workgroup_size(256)
fn contribute_sum(@builtin(workgroup_id) workgroup: vec3u, @builtin(local_invocation_index) local: u32) {
    let splat = group_index(workgroup) * 256u + local;
    if (splat >= camera.count) {
        return;
    }
    let place = places[splat];
    var sum = vec4f(0.0);
    if (state.entries > 0u) {
        for (var entry = place.x; entry < place.x + place.y; entry++) {
            sum += entry_sums[entry];
        }
    }
    // Each sample counts as its share of a pixel.
    splat_sums[splat] = sum / f32(camera.samples * camera.samples);
}
