// Pass `adam`: moves a parameter (Kingma and Ba 2015). Twin: cpu/passes/adam.rs. It runs within
// `project_backward`, as soon as a parameter's gradient is known and the parameter is no longer
// needed, so gradients are never stored; for batches, within `apply`, from gradients that are.

struct Optimizer {
    position: f32,
    rotation: f32,
    log_scale: f32,
    opacity_logit: f32,
    sh_dc: f32,
    sh_rest: f32,
    luminance_dc: f32,
    luminance_rest: f32,
    // sqrt(1 / (1 - beta_2^t)). The host multiplies rates by 1 / (1 - beta_1^t).
    root_correction_2: f32,
    // Weights of the regularisers, divided by the number of values that they average.
    opacity_weight: f32,
    scale_weight: f32,
    // Scale of the positions' noise; 0 for none.
    noise_scale: f32,
    seed_low: u32,
    seed_high: u32,
    // Whether densification statistics are collected.
    stats: u32,
    // Decay rates of the moments.
    beta_1: f32,
    beta_2: f32,
    padding_0: u32,
    padding_1: u32,
    padding_2: u32,
}

// ONLY_GRADIENTS: gradients are stored in place of the first moments, and nothing else changes.
// ONLY_CAMERA: nothing changes.
fn update_parameter(row: u32, i: u32, gradient: f32, rate: f32) {
    if (ONLY_CAMERA) {
        return;
    }
    let at = row * shard.stride + i;
    if (ONLY_GRADIENTS) {
        first[at] = gradient;
        return;
    }
    // Frozen: parameters and moments keep their bits.
    if (rate == 0.0) {
        return;
    }
    let m = first[at] * optimizer.beta_1 + gradient * (1.0 - optimizer.beta_1);
    let v = second[at] * optimizer.beta_2 + (gradient * gradient) * (1.0 - optimizer.beta_2);
    first[at] = m;
    second[at] = v;
    parameters[at] -= m * rate / (sqrt(v) * optimizer.root_correction_2 + ADAM_EPSILON);
}
