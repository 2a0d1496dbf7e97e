// Pass `loss`: (1 - w) D + w (1 - SSIM) of mu-law images, where D is their L1, partly squared, and
// its gradient by the pixels' radiance. Twin: cpu/passes/loss.
//
// A workgroup is 16x16 pixels, one channel after the other. `loss_ssim` loads values with a halo
// into workgroup memory and applies the window of SSIM along rows, then down columns; out: sums of
// |difference|, SSIM and difference^2 per workgroup, and SSIM's derivatives by the means of x, x^2
// and xy. `loss_gradient` convolves the derivatives with the same window (it is symmetric, and the
// padding is zero, so it is its own adjoint) and computes the gradient by radiance. `loss_report`
// adds up the sums of all workgroups in a fixed order; it halts the engine if the loss is not
// finite, before anything has changed. With x a pixel's prediction under the mu-law, y its target
// and w its weight, w x + (1 - w) y takes the place of the prediction. The radiance of a pixel is
// the mean of its samples, times `gain_at` its place, if the lens has vignetting (vignetting.wgsl,
// else no_vignetting.wgsl); each sample gets its share of the gradient.

struct Loss {
    mu: f32,
    // 1 / ln(1 + mu)
    scale: f32,
    ssim_weight: f32,
    // Share of L1 that is not squared.
    l1_weight: f32,
    // Share of L1 that is squared, divided by twice the difference at which both have the same
    // slope.
    l2_weight: f32,
    // Gradients by the mu-law value at radiance 0: of L1, by the difference, and of half the
    // derivative of the sum of SSIM.
    l1_factor: f32,
    l2_factor: f32,
    ssim_factor: f32,
    // 1 / the number of averaged values.
    l1_mean: f32,
    ssim_mean: f32,
    is_masked: u32,
    padding: u32,
    // Factor of each channel of the target.
    target_scale: vec3f,
    // Reciprocal of the distance from the axis at which r is 1.
    inverse_unit: f32,
    // Coefficients of 1, r^2, r^4 and r^6 in ln gain.
    log_gain: vec4f,
    // Place of the lens's axis.
    axis_px: vec2f,
    padding_2: vec2u,
}

@group(0) @binding(0) var<uniform> camera: Camera;
@group(0) @binding(1) var<uniform> config: Loss;
@group(0) @binding(2) var<storage, read> image: array<f32>;
@group(0) @binding(3) var<storage, read> target_image: array<f32>;
// One weight per pixel.
@group(0) @binding(4) var<storage, read> mask: array<f32>;
// By the means of x, x^2, xy: [3 channels * 3, H*W].
@group(0) @binding(5) var<storage, read_write> derivatives: array<f32>;
@group(0) @binding(6) var<storage, read_write> group_sums: array<vec4f>;
@group(0) @binding(7) var<storage, read> last_entries: array<u32>;
@group(0) @binding(8) var<storage, read_write> pixel_gradients: array<vec4f>;
@group(0) @binding(9) var<storage, read_write> state: State;

const SIDE = 16u;
const HALO_SIDE = SIDE + 2u * SSIM_RADIUS;
const HALO = HALO_SIDE * HALO_SIDE;
const STRIP = HALO_SIDE * SIDE;

fn weight_of(pixel: u32) -> f32 {
    if (config.is_masked == 0u) {
        return 1.0;
    }
    return mask[pixel];
}

// The mu-law value of a prediction, mixed with the target's if its weight is less than 1.
fn weighted(x: f32, y: f32, weight: f32) -> f32 {
    return select(weight * x + (1.0 - weight) * y, x, weight == 1.0);
}

fn mu_law(radiance: f32) -> f32 {
    let x = config.mu * max(radiance, 0.0);
    // ln(1 + x), by a series that keeps the small digits of x.
    return config.scale * select(log(1.0 + x), x * (1.0 - x * (0.5 - x * (1.0 / 3.0 - x * 0.25))), x < 0.02);
}

// Position in the image of a place in the halo.
fn halo_pixel(group: vec2u, n: u32) -> vec2i {
    return vec2i(group * SIDE) + vec2i(i32(n % HALO_SIDE), i32(n / HALO_SIDE)) - i32(SSIM_RADIUS);
}

// Of the image.
fn size_px() -> vec2u {
    return camera.size_px / camera.samples;
}

fn is_inside(at: vec2i) -> bool {
    return all(at >= vec2i(0)) && all(at < vec2i(size_px()));
}

// Number of sample `n` of the pixel in column and row `at`.
fn sample_of(at: vec2u, n: u32) -> u32 {
    let sample = at * camera.samples + vec2u(n % camera.samples, n / camera.samples);
    return sample.y * camera.size_px.x + sample.x;
}

fn radiance_at(at: vec2u, channel: u32) -> f32 {
    let count = camera.samples * camera.samples;
    var sum = 0.0;
    for (var n = 0u; n < count; n++) {
        sum += image[3u * sample_of(at, n) + channel];
    }
    return sum / f32(count);
}

// The radiance of a pixel as the view shows it.
fn seen_at(at: vec2u, channel: u32) -> f32 {
    return gain_at(at) * radiance_at(at, channel);
}

var<workgroup> predictions: array<f32, HALO>;
var<workgroup> targets: array<f32, HALO>;
var<workgroup> row_means: array<vec4f, STRIP>;
var<workgroup> totals: array<vec4f, 256>;

// Leaves the sum over the workgroup's 256 threads in totals[0], for all of them to read. Its order
// is that of a tree, the same every time.
fn add_over_workgroup(local: u32, own: vec4f) {
    totals[local] = own;
    workgroupBarrier();
    for (var half = 128u; half > 0u; half /= 2u) {
        if (local < half) {
            totals[local] += totals[local + half];
        }
        workgroupBarrier();
    }
}

@compute @workgroup_size(256)
fn loss_ssim(@builtin(workgroup_id) workgroup: vec3u, @builtin(local_invocation_index) local: u32) {
    let at = workgroup.xy * SIDE + vec2u(local % SIDE, local / SIDE);
    let size = size_px();
    let inside = all(at < size);
    let pixel = at.y * size.x + at.x;
    let pixels = size.x * size.y;
    var total = vec4f(0.0);
    for (var channel = 0u; channel < 3u; channel++) {
        for (var n = local; n < HALO; n += 256u) {
            let from_px = halo_pixel(workgroup.xy, n);
            var x = 0.0;
            var y = 0.0;
            if (is_inside(from_px)) {
                let source = u32(from_px.y) * size.x + u32(from_px.x);
                y = mu_law(target_image[3u * source + channel] * config.target_scale[channel]);
                x = y;
                let weight = weight_of(source);
                // A prediction of weight 0 has no effect, even if it is NaN.
                if (weight > 0.0) {
                    x = weighted(mu_law(seen_at(vec2u(from_px), channel)), y, weight);
                }
            }
            predictions[n] = x;
            targets[n] = y;
        }
        workgroupBarrier();
        for (var n = local; n < STRIP; n += 256u) {
            let start = n / SIDE * HALO_SIDE + n % SIDE;
            var means = vec4f(0.0);
            for (var k = 0u; k < SSIM_TAPS; k++) {
                let x = predictions[start + k];
                let y = targets[start + k];
                means += SSIM_WINDOW[k] * vec4f(x, y, x * x + y * y, x * y);
            }
            row_means[n] = means;
        }
        workgroupBarrier();
        if (inside) {
            var m = vec4f(0.0);
            for (var k = 0u; k < SSIM_TAPS; k++) {
                m += SSIM_WINDOW[k] * row_means[local + k * SIDE];
            }
            let mean_squares = m.x * m.x + m.y * m.y;
            let mean_product = m.x * m.y;
            let a = 2.0 * mean_product + SSIM_C1;
            let b = 2.0 * (m.w - mean_product) + SSIM_C2;
            let d = mean_squares + SSIM_C1;
            let e = m.z - mean_squares + SSIM_C2;
            let inverse = 1.0 / (d * e);
            let ssim = a * b * inverse;
            // Half of the derivatives: by the mean of x at constant sums of variances, of x^2, of
            // xy.
            derivatives[3u * channel * pixels + pixel] = (m.y * (b - a) + m.x * ssim * (d - e)) * inverse;
            derivatives[(3u * channel + 1u) * pixels + pixel] = -(ssim * (d * inverse));
            derivatives[(3u * channel + 2u) * pixels + pixel] = a * inverse;
            let center = (local / SIDE + SSIM_RADIUS) * HALO_SIDE + local % SIDE + SSIM_RADIUS;
            let difference = predictions[center] - targets[center];
            total += vec4f(abs(difference), ssim, difference * difference, 0.0);
        }
        workgroupBarrier();
    }
    add_over_workgroup(local, total);
    if (local == 0u) {
        group_sums[workgroup.y * ((size.x + SIDE - 1u) / SIDE) + workgroup.x] = totals[0];
    }
}

// Separate numbers: a vec3f would take the space of four.
var<workgroup> halo_derivatives: array<array<f32, 3>, HALO>;
var<workgroup> row_derivatives: array<array<f32, 3>, STRIP>;

fn vector(values: array<f32, 3>) -> vec3f {
    return vec3f(values[0], values[1], values[2]);
}

@compute @workgroup_size(256)
fn loss_gradient(@builtin(workgroup_id) workgroup: vec3u, @builtin(local_invocation_index) local: u32) {
    let at = workgroup.xy * SIDE + vec2u(local % SIDE, local / SIDE);
    let size = size_px();
    let inside = all(at < size);
    let pixel = at.y * size.x + at.x;
    let pixels = size.x * size.y;
    var gradient = vec3f(0.0);
    for (var channel = 0u; channel < 3u; channel++) {
        for (var n = local; n < HALO; n += 256u) {
            let from_px = halo_pixel(workgroup.xy, n);
            var by = vec3f(0.0);
            if (is_inside(from_px)) {
                let source = u32(from_px.y) * size.x + u32(from_px.x);
                let plane = 3u * channel * pixels + source;
                by = vec3f(derivatives[plane], derivatives[plane + pixels], derivatives[plane + 2u * pixels]);
            }
            halo_derivatives[n] = array<f32, 3>(by.x, by.y, by.z);
        }
        workgroupBarrier();
        for (var n = local; n < STRIP; n += 256u) {
            let start = n / SIDE * HALO_SIDE + n % SIDE;
            var sum = vec3f(0.0);
            for (var k = 0u; k < SSIM_TAPS; k++) {
                sum += SSIM_WINDOW[k] * vector(halo_derivatives[start + k]);
            }
            row_derivatives[n] = array<f32, 3>(sum.x, sum.y, sum.z);
        }
        workgroupBarrier();
        if (inside) {
            var by = vec3f(0.0);
            for (var k = 0u; k < SSIM_TAPS; k++) {
                by += SSIM_WINDOW[k] * vector(row_derivatives[local + k * SIDE]);
            }
            let radiance = max(seen_at(at, channel), 0.0);
            let weight = weight_of(pixel);
            let y = mu_law(target_image[3u * pixel + channel] * config.target_scale[channel]);
            let x = weighted(mu_law(radiance), y, weight);
            let by_ssim = by.x + by.y * x + by.z * y;
            // T'(p) = mu / ((1 + mu p) ln(1 + mu)); the factors hold all but 1 / (1 + mu p).
            let by_difference = sign(x - y) * config.l1_factor + (x - y) * config.l2_factor;
            let by_value = by_ssim * config.ssim_factor + by_difference;
            // No store with a dynamic index: some compilers refuse it in a loop with barriers.
            let value = weight * by_value / (1.0 + config.mu * radiance);
            gradient = select(gradient, vec3f(value), vec3u(0u, 1u, 2u) == vec3u(channel));
        }
        workgroupBarrier();
    }
    if (inside) {
        // Pixels of weight 0 entered the windows with the target's values, which do not depend on
        // the prediction.
        let moved = select(vec3f(0.0), gradient * gain_at(at), weight_of(pixel) > 0.0);
        let count = camera.samples * camera.samples;
        for (var n = 0u; n < count; n++) {
            let sample = sample_of(at, n);
            pixel_gradients[sample] = vec4f(moved / f32(count), f32(last_entries[sample]));
        }
    }
}

@compute @workgroup_size(256)
fn loss_report(@builtin(local_invocation_index) local: u32) {
    let tiles = (size_px() + SIDE - 1u) / SIDE;
    var total = vec4f(0.0);
    for (var n = local; n < tiles.x * tiles.y; n += 256u) {
        total += group_sums[n];
    }
    add_over_workgroup(local, total);
    if (local == 0u) {
        let l1 = totals[0].x * config.l1_mean;
        let ssim = totals[0].y * config.ssim_mean;
        let difference = config.l1_weight * l1 + config.l2_weight * totals[0].z * config.l1_mean;
        let loss = (1.0 - config.ssim_weight) * difference + config.ssim_weight * (1.0 - ssim);
        state.l1 = l1;
        state.ssim = ssim;
        state.loss = loss;
        if (!is_finite(loss) && state.halted == HALT_NONE) {
            state.halted = HALT_NOT_FINITE;
        }
    }
}
