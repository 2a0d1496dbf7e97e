// Pass `camera_backward`: computes the gradient by the camera, for steps that ask for it, before
// `project_backward` updates the parameters. Twin: cpu/passes/camera_backward.rs; the derivation is
// core's (engine/camera_gradient.rs).
//
// One thread per splat of the shard. Out: the sums of each workgroup, two vec4f: the moment of the
// gradients about the camera's centre with that of the splats' own axes; the gradients by the
// position; those by the focal lengths. The host adds workgroups up in their order.

@group(0) @binding(10) var<storage, read_write> camera_sums: array<vec4f>;

var<workgroup> camera_partials: array<array<vec4f, 2>, 128>;

@compute @workgroup_size(128)
fn camera_backward(@builtin(workgroup_id) workgroup: vec3u, @builtin(local_invocation_index) local: u32) {
    let group = group_index(workgroup);
    let i = group * 128u + local;
    var turn_shift = vec4f(0.0);
    var shift_focal = vec4f(0.0);
    if (i < shard.len && state.halted == HALT_NONE) {
        let splat = shard.base + i;
        if (places[splat].y > 0u) {
            let sums = gather_sums(splat);
            let geometry = geometry_backward(i, sums);
            let g = geometry.position;
            let d = g + color_backward(i, true, sums.radiance);
            let q = vec4f(
                parameter(ROW_ROTATION, i),
                parameter(ROW_ROTATION + 1u, i),
                parameter(ROW_ROTATION + 2u, i),
                parameter(ROW_ROTATION + 3u, i),
            );
            let d_q = geometry.rotation;
            // A rotation by r of the splat turns its quaternion q by r q / 2.
            let own = q.x * d_q.yzw - d_q.x * q.yzw + cross(q.yzw, d_q.yzw);
            let turn = cross(parameter3(ROW_POSITION, i) - camera.eye.xyz, g) + 0.5 * own;
            turn_shift = vec4f(turn, finite(d.x));
            shift_focal = vec4f(finite(d.y), finite(d.z), geometry.focal_px);
        }
    }
    camera_partials[local] = array<vec4f, 2>(turn_shift, shift_focal);
    workgroupBarrier();
    for (var half = 64u; half > 0u; half /= 2u) {
        if (local < half) {
            camera_partials[local][0] += camera_partials[local + half][0];
            camera_partials[local][1] += camera_partials[local + half][1];
        }
        workgroupBarrier();
    }
    if (local < 2u && group * 128u < shard.len) {
        camera_sums[2u * group + local] = camera_partials[0][local];
    }
}
