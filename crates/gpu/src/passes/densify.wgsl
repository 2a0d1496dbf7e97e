// Pass `densify`: rebuilds the scene from a plan. Twin: cpu/passes/densify.rs.
//
// One thread per row of the plan. It runs for every pair of a shard of the old scene and one of the
// new: rows whose source lies in another old shard are skipped. In: plan, old parameters and
// moments. Out: the new ones; statistics are cleared elsewhere. The old scene's 3D filter is
// copied, or replaced by the plan's if it has one.

struct PlanRow {
    source: u32,
    // KEEP_MOMENTS, NEW_OPACITY
    flags: u32,
    opacity_logit: f32,
    log_scale_shift: f32,
    offset_sigma: vec3f,
    smoothing: f32,
}

struct Densify {
    // Start and length of the old shard; strides of both shards.
    source_base: u32,
    source_len: u32,
    source_stride: u32,
    // Number of rows of the new shard; its first row in the plan.
    base: u32,
    len: u32,
    stride: u32,
    // CAP_OPACITY, NEW_SMOOTHING
    flags: u32,
    opacity_logit_cap: f32,
}

@group(0) @binding(0) var<uniform> config: Densify;
@group(0) @binding(1) var<storage, read> plan: array<PlanRow>;
@group(0) @binding(2) var<storage, read> old_parameters: array<f32>;
@group(0) @binding(3) var<storage, read> old_first: array<f32>;
@group(0) @binding(4) var<storage, read> old_second: array<f32>;
@group(0) @binding(5) var<storage, read_write> parameters: array<f32>;
@group(0) @binding(6) var<storage, read_write> first: array<f32>;
@group(0) @binding(7) var<storage, read_write> second: array<f32>;

@compute @workgroup_size(256)
fn densify(@builtin(workgroup_id) workgroup: vec3u, @builtin(local_invocation_index) local: u32) {
    let i = group_index(workgroup) * 256u + local;
    if (i >= config.len) {
        return;
    }
    let row = plan[config.base + i];
    if (row.source < config.source_base || row.source - config.source_base >= config.source_len) {
        return;
    }
    let source = row.source - config.source_base;
    let keeps_moments = (row.flags & PLAN_KEEP_MOMENTS) != 0u;
    for (var r = 0u; r < ROWS; r++) {
        let from_at = r * config.source_stride + source;
        let at = r * config.stride + i;
        parameters[at] = old_parameters[from_at];
        first[at] = select(0.0, old_first[from_at], keeps_moments);
        second[at] = select(0.0, old_second[from_at], keeps_moments);
    }
    let smoothing = (ROW_SMOOTHING) * config.stride + i;
    parameters[smoothing] = old_parameters[ROW_SMOOTHING * config.source_stride + source];
    if ((config.flags & DENSIFY_SMOOTHING) != 0u) {
        parameters[smoothing] = row.smoothing;
    }
    change(i, row);
}

fn change(i: u32, row: PlanRow) {
    let stride = config.stride;
    if (any(row.offset_sigma != vec3f(0.0))) {
        let q = ROW_ROTATION * stride + i;
        let raw = vec4f(parameters[q], parameters[q + stride], parameters[q + 2u * stride], parameters[q + 3u * stride]);
        let unit = raw / sqrt(max(dot(raw, raw), 1e-30));
        let s = ROW_LOG_SCALE * stride + i;
        let sigma = exp(vec3f(parameters[s], parameters[s + stride], parameters[s + 2u * stride]));
        let axes = rotation_rows(unit);
        let offset = sigma * row.offset_sigma;
        for (var k = 0u; k < 3u; k++) {
            parameters[(ROW_POSITION + k) * stride + i] += dot(axes[k], offset);
        }
    }
    for (var k = 0u; k < 3u; k++) {
        parameters[(ROW_LOG_SCALE + k) * stride + i] += row.log_scale_shift;
    }
    let opacity = ROW_OPACITY * stride + i;
    if ((row.flags & PLAN_NEW_OPACITY) != 0u) {
        parameters[opacity] = row.opacity_logit;
    }
    if ((config.flags & DENSIFY_CAP) != 0u && parameters[opacity] > config.opacity_logit_cap) {
        parameters[opacity] = config.opacity_logit_cap;
        first[opacity] = 0.0;
        second[opacity] = 0.0;
    }
}
