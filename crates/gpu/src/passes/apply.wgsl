// Pass `adam` for batches: moves the parameters of a shard by gradients that are there already,
// and adds their statistics. Twin: cpu/passes/sparse_update.rs.
//
// One thread per splat of the shard. In: gradients, and behind them the statistics of the batch.
// In, out: parameters, moments, densification statistics.

@group(0) @binding(1) var<uniform> shard: Shard;
@group(0) @binding(2) var<uniform> optimizer: Optimizer;
@group(0) @binding(4) var<storage, read> gradients: array<f32>;
@group(0) @binding(5) var<storage, read> batch_stats: array<f32>;
@group(0) @binding(6) var<storage, read_write> parameters: array<f32>;
@group(0) @binding(7) var<storage, read_write> first: array<f32>;
@group(0) @binding(8) var<storage, read_write> second: array<f32>;
@group(0) @binding(9) var<storage, read_write> stats: array<f32>;

fn rate_of(row: u32) -> f32 {
    if (row < ROW_ROTATION) {
        return optimizer.position;
    }
    if (row < ROW_LOG_SCALE) {
        return optimizer.rotation;
    }
    if (row < ROW_OPACITY) {
        return optimizer.log_scale;
    }
    if (row == ROW_OPACITY) {
        return optimizer.opacity_logit;
    }
    if (row < ROW_LUMINANCE) {
        return select(optimizer.sh_rest, optimizer.sh_dc, row < ROW_SH + 3u);
    }
    return select(optimizer.luminance_rest, optimizer.luminance_dc, row == ROW_LUMINANCE);
}

@compute @workgroup_size(128)
fn apply(@builtin(workgroup_id) workgroup: vec3u, @builtin(local_invocation_index) local: u32) {
    let i = group_index(workgroup) * 128u + local;
    if (i >= shard.len) {
        return;
    }
    for (var row = 0u; row < ROWS; row++) {
        update_parameter(row, i, gradients[row * shard.stride + i], rate_of(row));
    }
    if (optimizer.stats != 0u) {
        for (var row = 0u; row < 3u; row++) {
            stats[row * shard.stride + i] += batch_stats[row * shard.stride + i];
        }
    }
    if (optimizer.noise_scale != 0.0) {
        let moved = position_noise(i, shard.base + i);
        for (var k = 0u; k < 3u; k++) {
            parameters[(ROW_POSITION + k) * shard.stride + i] += moved[k];
        }
    }
}
