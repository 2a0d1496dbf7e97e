// Access to the parameters of a splat of the shard.

fn parameter(row: u32, i: u32) -> f32 {
    return parameters[row * shard.stride + i];
}

fn parameter3(row: u32, i: u32) -> vec3f {
    return vec3f(parameter(row, i), parameter(row + 1u, i), parameter(row + 2u, i));
}
