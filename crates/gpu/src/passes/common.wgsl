// Declarations for every pass: the camera, the current shard of splats, the state of a step. Twins
// in Rust: layout.rs; constants are inserted from there and from core.

struct Camera {
    // Rows of camera_from_world; w is the translation.
    row_x: vec4f,
    row_y: vec4f,
    row_z: vec4f,
    eye: vec4f,
    background: vec4f,
    focal_px: vec2f,
    center_px: vec2f,
    // Range of x/z and y/z to which the projection's Jacobian is clamped.
    slope_min: vec2f,
    slope_max: vec2f,
    size_px: vec2u,
    tiles: vec2u,
    min_alpha: f32,
    min_contribution: f32,
    alpha_floor: f32,
    min_transmittance: f32,
    max_alpha: f32,
    near: f32,
    dilation_px2: f32,
    active_degree: u32,
    flags: u32,
    // Number of splats in all shards.
    count: u32,
    // Capacity of the buffers for entries.
    entry_capacity: u32,
    // Samples along the side of an image pixel. In all passes but the loss, "pixel" means a sample.
    samples: u32,
    // The share of splats that the step leaves out, the factor of the others' opacities, and the
    // seed of the choice.
    dropout_rate: f32,
    opacity_factor: f32,
    dropout_seed: u32,
    padding: u32,
}

// The splats of one shard: a run of the scene's splats whose parameters share buffers.
struct Shard {
    // First splat of the shard in the scene.
    base: u32,
    len: u32,
    // Length of a row: the number of splats for which the shard's buffers have room.
    stride: u32,
    padding: u32,
}

// The results of a step for the host and for later passes.
struct State {
    // Number of entries: pairs of a splat and a tile.
    entries: u32,
    // Reason why later passes change nothing: see HALT_.
    halted: u32,
    // Number of entries that larger buffers would hold.
    needed: u32,
    visible: u32,
    l1: f32,
    ssim: f32,
    loss: f32,
    padding: u32,
}

// Linear number of a workgroup of a dispatch that may be folded into rows of MAX_GROUPS. The length
// of a row is a constant, because Direct3D 12 does not provide the number of workgroups of an
// indirect dispatch.
fn group_index(workgroup: vec3u) -> u32 {
    return workgroup.y * MAX_GROUPS + workgroup.x;
}

fn is_finite(value: f32) -> bool {
    return (bitcast<u32>(value) & 0x7f800000u) != 0x7f800000u;
}
