// What every pass knows: the camera, the splats at hand, where work is counted. Twins in Rust: layout.rs; constants are injected from there
// and from core.

struct Camera {
    // Rows of camera_from_world; w is the translation.
    row_x: vec4f,
    row_y: vec4f,
    row_z: vec4f,
    eye: vec4f,
    background: vec4f,
    focal_px: vec2f,
    center_px: vec2f,
    // Range of x/z and y/z in which the projection's Jacobian is evaluated where it is.
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
    // All splats, of all shards.
    count: u32,
    // Entries that the buffers hold.
    entry_capacity: u32,
    // Along the side of a pixel of the image: what is called pixels here are samples of them, but for the loss.
    samples: u32,
}

// The splats of one shard: a run of the scene's splats whose parameters share buffers.
struct Shard {
    // Its first splat in the scene.
    base: u32,
    len: u32,
    // Splats that the shard's buffers have room for: a row's length.
    stride: u32,
    padding: u32,
}

// What a step leaves for the host, and for the passes behind.
struct State {
    // Pairs of a splat and a tile.
    entries: u32,
    // Why nothing is changed any more: see HALT_.
    halted: u32,
    // Entries that there would be with larger buffers.
    needed: u32,
    visible: u32,
    l1: f32,
    ssim: f32,
    loss: f32,
    padding: u32,
}

// Linear number of a workgroup of a dispatch that may be folded into rows of MAX_GROUPS. The row's length is no question to the device: Direct3D 12
// does not tell the number of workgroups where the device itself decided it.
fn group_index(workgroup: vec3u) -> u32 {
    return workgroup.y * MAX_GROUPS + workgroup.x;
}

fn is_finite(value: f32) -> bool {
    return (bitcast<u32>(value) & 0x7f800000u) != 0x7f800000u;
}
