// Adds up the entries of splats that have many of them: the first part of pass `project_backward`.
//
// A thread sums a splat's entries by itself if they are at most GATHER_ALONE. The entries of a
// splat with more are summed here by a whole workgroup, in an order that depends only on their
// number, and the sum is stored in the splat's first entry.

@group(0) @binding(0) var<uniform> camera: Camera;
@group(0) @binding(1) var<storage, read> state: State;
@group(0) @binding(2) var<storage, read> places: array<vec2u>;
@group(0) @binding(3) var<storage, read_write> entry_gradients: array<vec4f>;

var<workgroup> large: array<u32, 256>;
var<workgroup> large_count: atomic<u32>;
var<workgroup> large_total: u32;
var<workgroup> partials: array<array<vec4f, 3>, 256>;

@compute @workgroup_size(256)
fn gather(@builtin(workgroup_id) workgroup: vec3u, @builtin(local_invocation_index) local: u32) {
    let splat = group_index(workgroup) * 256u + local;
    if (local == 0u) {
        atomicStore(&large_count, 0u);
    }
    workgroupBarrier();
    if (splat < camera.count && state.entries > 0u) {
        if (places[splat].y > GATHER_ALONE) {
            large[atomicAdd(&large_count, 1u)] = splat;
        }
    }
    workgroupBarrier();
    if (local == 0u) {
        large_total = atomicLoad(&large_count);
    }
    let total = workgroupUniformLoad(&large_total);
    for (var n = 0u; n < total; n++) {
        let place = places[large[n]];
        var sum = array<vec4f, 3>(vec4f(0.0), vec4f(0.0), vec4f(0.0));
        for (var entry = place.x + local; entry < place.x + place.y; entry += 256u) {
            sum[0] += entry_gradients[3u * entry];
            sum[1] += entry_gradients[3u * entry + 1u];
            sum[2] += entry_gradients[3u * entry + 2u];
        }
        partials[local] = sum;
        workgroupBarrier();
        for (var half = 128u; half > 0u; half /= 2u) {
            if (local < half) {
                partials[local][0] += partials[local + half][0];
                partials[local][1] += partials[local + half][1];
                partials[local][2] += partials[local + half][2];
            }
            workgroupBarrier();
        }
        if (local < 3u) {
            entry_gradients[3u * place.x + local] = partials[0][local];
        }
        workgroupBarrier();
    }
}
