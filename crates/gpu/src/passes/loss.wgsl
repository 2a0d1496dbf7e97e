// Pass `loss`: (1 - w) D + w (1 - SSIM) of mu-law images, where D is their L1, partly squared, and
// its gradient by the pixels' radiance. Twin: cpu/passes/loss.
//
// A workgroup is 16x16 pixels. `loss_ssim` takes all channels of its pixels and of a halo under the
// mu-law; then, one channel after the other, it applies the window of SSIM along rows, then down
// columns, in workgroup memory. Out: sums of |difference|, SSIM and difference^2 per workgroup, and
// SSIM's derivatives by the means of x, x^2 and xy. `loss_gradient` convolves the derivatives with
// the same window (it is symmetric, and the padding is zero, so it is its own adjoint) and computes
// the gradient by radiance. A workgroup behind the image's adds up the sums of all workgroups in a
// fixed order: the report. It halts the engine if the loss is not finite, before anything has
// changed. With x a pixel's prediction under the mu-law, y its target and w its weight,
// w x + (1 - w) y takes the place of the prediction. The radiance of a pixel is the mean of its
// samples, times `gain_at` its place, if the lens has vignetting (vignetting.wgsl, else
// no_vignetting.wgsl); each sample gets its share of the gradient.
//
// The functions that apply the window, `moments_of_row`, `moments_of_column`, `derivatives_of_row`
// and `derivatives_of_column`, are written out tap by tap (constants.rs): a table that is indexed
// at run time would be copied to a variable at each access.

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

const SIDE = TILE_PX;
const HALO_SIDE = SIDE + 2u * SSIM_RADIUS;
const HALO = HALO_SIDE * HALO_SIDE;
const STRIP = HALO_SIDE * SIDE;
// A thread has up to three places of the halo and two of the strip.
const_assert HALO > 512u && HALO <= 768u && STRIP <= 512u;

fn weight_of(pixel: u32) -> f32 {
    if (config.is_masked == 0u) {
        return 1.0;
    }
    return mask[pixel];
}

// The mu-law values of a prediction, mixed with the target's if its weight is less than 1.
fn weighted(x: vec3f, y: vec3f, weight: f32) -> vec3f {
    return select(weight * x + (1.0 - weight) * y, x, vec3<bool>(weight == 1.0));
}

fn mu_law(radiance: vec3f) -> vec3f {
    let x = config.mu * max(radiance, vec3f(0.0));
    // ln(1 + x), by a series that keeps the small digits of x.
    return config.scale * select(log(1.0 + x), x * (1.0 - x * (0.5 - x * (1.0 / 3.0 - x * 0.25))), x < vec3f(0.02));
}

// Position in the image of a place in the halo.
fn halo_pixel(group: vec2u, n: u32) -> vec2i {
    return vec2i(group * SIDE) + vec2i(i32(n % HALO_SIDE), i32(n / HALO_SIDE)) - i32(SSIM_RADIUS);
}

// Of the image.
fn size_px() -> vec2u {
    return camera.size_px / camera.samples;
}

fn tile_counts(size: vec2u) -> vec2u {
    return (size + SIDE - 1u) / SIDE;
}

fn is_inside(at: vec2i, size: vec2u) -> bool {
    return all(at >= vec2i(0)) && all(at < vec2i(size));
}

// The mean over a pixel's samples.
fn radiance_at(at: vec2u) -> vec3f {
    var sum = vec3f(0.0);
    for (var row = 0u; row < camera.samples; row++) {
        let first = 3u * ((at.y * camera.samples + row) * camera.size_px.x + at.x * camera.samples);
        for (var value = first; value < first + 3u * camera.samples; value += 3u) {
            sum += vec3f(image[value], image[value + 1u], image[value + 2u]);
        }
    }
    return sum / f32(camera.samples * camera.samples);
}

// The radiance of a pixel as the view shows it.
fn seen_at(at: vec2u) -> vec3f {
    return gain_at(at) * radiance_at(at);
}

// The target of a pixel under the mu-law.
fn target_at(pixel: u32) -> vec3f {
    let radiance = vec3f(target_image[3u * pixel], target_image[3u * pixel + 1u], target_image[3u * pixel + 2u]);
    return mu_law(radiance * config.target_scale);
}

// Prediction and target of a pixel under the mu-law; zero outside of the image.
struct Compared {
    prediction: vec3f,
    truth: vec3f,
}

fn compared(from_px: vec2i, size: vec2u) -> Compared {
    if (!is_inside(from_px, size)) {
        return Compared(vec3f(0.0), vec3f(0.0));
    }
    let at = vec2u(from_px);
    let pixel = at.y * size.x + at.x;
    let y = target_at(pixel);
    let weight = weight_of(pixel);
    var x = y;
    // A prediction of weight 0 has no effect, even if it is NaN.
    if (weight > 0.0) {
        x = weighted(mu_law(seen_at(at)), y, weight);
    }
    return Compared(x, y);
}

// Prediction and target of a channel.
var<workgroup> halo: array<vec2f, HALO>;
// Sums along rows; then, for `add_over_workgroup`, sums over threads.
var<workgroup> rows: array<vec4f, STRIP>;

// x, y, x^2 + y^2 and xy at a place of the halo.
fn moments_at(n: u32) -> vec4f {
    let v = halo[n];
    return vec4f(v, dot(v, v), v.x * v.y);
}

fn row_at(n: u32) -> vec4f {
    return rows[n];
}

// The place in the halo where the row of place `n` of the strip begins.
fn row_start(n: u32) -> u32 {
    return n / SIDE * HALO_SIDE + n % SIDE;
}

// Leaves the sum over the workgroup's 256 threads in rows[0], for all of them to read. Its order is
// that of a tree, the same every time.
fn add_over_workgroup(local: u32, own: vec4f) {
    workgroupBarrier();
    rows[local] = own;
    workgroupBarrier();
    for (var half = 128u; half > 0u; half /= 2u) {
        if (local < half) {
            rows[local] += rows[local + half];
        }
        workgroupBarrier();
    }
}

// Means of a channel, x, y, x^2 + y^2 and xy, around a thread's pixel; `a` to `c` are the thread's
// places in the halo.
fn means_of_channel(local: u32, a: vec2f, b: vec2f, c: vec2f) -> vec4f {
    halo[local] = a;
    halo[local + 256u] = b;
    if (local + 512u < HALO) {
        halo[local + 512u] = c;
    }
    workgroupBarrier();
    rows[local] = moments_of_row(row_start(local));
    if (local + 256u < STRIP) {
        rows[local + 256u] = moments_of_row(row_start(local + 256u));
    }
    workgroupBarrier();
    return moments_of_column(local);
}

// SSIM from the means of a channel; stores its derivatives.
fn ssim_of(means: vec4f, plane: u32, pixel: u32, pixels: u32) -> f32 {
    let mean_squares = means.x * means.x + means.y * means.y;
    let mean_product = means.x * means.y;
    let a = 2.0 * mean_product + SSIM_C1;
    let b = 2.0 * (means.w - mean_product) + SSIM_C2;
    let d = mean_squares + SSIM_C1;
    let e = means.z - mean_squares + SSIM_C2;
    let inverse = 1.0 / (d * e);
    let ssim = a * b * inverse;
    // Half of the derivatives: by the mean of x at constant sums of variances, of x^2, of xy.
    derivatives[plane * pixels + pixel] = (means.y * (b - a) + means.x * ssim * (d - e)) * inverse;
    derivatives[(plane + 1u) * pixels + pixel] = -(ssim * (d * inverse));
    derivatives[(plane + 2u) * pixels + pixel] = a * inverse;
    return ssim;
}

@compute @workgroup_size(256)
fn loss_ssim(@builtin(workgroup_id) workgroup: vec3u, @builtin(local_invocation_index) local: u32) {
    let at = workgroup.xy * SIDE + vec2u(local % SIDE, local / SIDE);
    let size = size_px();
    let a = compared(halo_pixel(workgroup.xy, local), size);
    let b = compared(halo_pixel(workgroup.xy, local + 256u), size);
    var c: Compared;
    if (local + 512u < HALO) {
        c = compared(halo_pixel(workgroup.xy, local + 512u), size);
    }
    let center = (local / SIDE + SSIM_RADIUS) * HALO_SIDE + local % SIDE + SSIM_RADIUS;
    let x = means_of_channel(local, vec2f(a.prediction.x, a.truth.x), vec2f(b.prediction.x, b.truth.x), vec2f(c.prediction.x, c.truth.x));
    let own_x = halo[center];
    workgroupBarrier();
    let y = means_of_channel(local, vec2f(a.prediction.y, a.truth.y), vec2f(b.prediction.y, b.truth.y), vec2f(c.prediction.y, c.truth.y));
    let own_y = halo[center];
    workgroupBarrier();
    let z = means_of_channel(local, vec2f(a.prediction.z, a.truth.z), vec2f(b.prediction.z, b.truth.z), vec2f(c.prediction.z, c.truth.z));
    let own_z = halo[center];
    var total = vec4f(0.0);
    if (all(at < size)) {
        let pixel = at.y * size.x + at.x;
        let pixels = size.x * size.y;
        let ssim = vec3f(ssim_of(x, 0u, pixel, pixels), ssim_of(y, 3u, pixel, pixels), ssim_of(z, 6u, pixel, pixels));
        let difference = vec3f(own_x.x - own_x.y, own_y.x - own_y.y, own_z.x - own_z.y);
        total = vec4f(dot(abs(difference), vec3f(1.0)), dot(ssim, vec3f(1.0)), dot(difference, difference), 0.0);
    }
    add_over_workgroup(local, total);
    if (local == 0u) {
        group_sums[workgroup.y * tile_counts(size).x + workgroup.x] = rows[0];
    }
}

// Derivatives of a channel. Separate numbers: a vec3f would take the space of four.
var<workgroup> halo_derivatives: array<array<f32, 3>, HALO>;

fn derivatives_at(n: u32) -> vec3f {
    let values = halo_derivatives[n];
    return vec3f(values[0], values[1], values[2]);
}

fn row_derivatives_at(n: u32) -> vec3f {
    return rows[n].xyz;
}

// Takes a place of the halo of the workgroup from three planes of derivatives.
fn load_derivatives(n: u32, group: vec2u, plane: u32, size: vec2u) {
    let from_px = halo_pixel(group, n);
    var by = array<f32, 3>(0.0, 0.0, 0.0);
    if (is_inside(from_px, size)) {
        let pixels = size.x * size.y;
        let at = plane * pixels + u32(from_px.y) * size.x + u32(from_px.x);
        by = array<f32, 3>(derivatives[at], derivatives[at + pixels], derivatives[at + 2u * pixels]);
    }
    halo_derivatives[n] = by;
}

// Means of a channel's derivatives around a thread's pixel.
fn mean_derivatives(local: u32, group: vec2u, plane: u32, size: vec2u) -> vec3f {
    load_derivatives(local, group, plane, size);
    load_derivatives(local + 256u, group, plane, size);
    if (local + 512u < HALO) {
        load_derivatives(local + 512u, group, plane, size);
    }
    workgroupBarrier();
    rows[local] = vec4f(derivatives_of_row(row_start(local)), 0.0);
    if (local + 256u < STRIP) {
        rows[local + 256u] = vec4f(derivatives_of_row(row_start(local + 256u)), 0.0);
    }
    workgroupBarrier();
    return derivatives_of_column(local);
}

@compute @workgroup_size(256)
fn loss_gradient(@builtin(workgroup_id) workgroup: vec3u, @builtin(local_invocation_index) local: u32) {
    let at = workgroup.xy * SIDE + vec2u(local % SIDE, local / SIDE);
    let size = size_px();
    let tiles = tile_counts(size);
    if (workgroup.y == tiles.y) {
        if (workgroup.x == 0u) {
            report(local, tiles);
        }
        return;
    }
    let by_x = mean_derivatives(local, workgroup.xy, 0u, size);
    let by_y = mean_derivatives(local, workgroup.xy, 3u, size);
    let by_z = mean_derivatives(local, workgroup.xy, 6u, size);
    if (any(at >= size)) {
        return;
    }
    let pixel = at.y * size.x + at.x;
    let radiance = max(seen_at(at), vec3f(0.0));
    let weight = weight_of(pixel);
    let y = target_at(pixel);
    let x = weighted(mu_law(radiance), y, weight);
    let by_ssim = vec3f(by_x.x, by_y.x, by_z.x) + vec3f(by_x.y, by_y.y, by_z.y) * x + vec3f(by_x.z, by_y.z, by_z.z) * y;
    // T'(p) = mu / ((1 + mu p) ln(1 + mu)); the factors hold all but 1 / (1 + mu p).
    let by_difference = sign(x - y) * config.l1_factor + (x - y) * config.l2_factor;
    let by_value = by_ssim * config.ssim_factor + by_difference;
    let gradient = weight * by_value / (1.0 + config.mu * radiance);
    // Pixels of weight 0 entered the windows with the target's values, which do not depend on the
    // prediction.
    let moved = select(vec3f(0.0), gradient * gain_at(at), weight > 0.0) / f32(camera.samples * camera.samples);
    for (var row = 0u; row < camera.samples; row++) {
        let first = (at.y * camera.samples + row) * camera.size_px.x + at.x * camera.samples;
        for (var sample = first; sample < first + camera.samples; sample++) {
            pixel_gradients[sample] = vec4f(moved, f32(last_entries[sample]));
        }
    }
}

fn report(local: u32, tiles: vec2u) {
    var total = vec4f(0.0);
    for (var n = local; n < tiles.x * tiles.y; n += 256u) {
        total += group_sums[n];
    }
    add_over_workgroup(local, total);
    if (local == 0u) {
        let l1 = rows[0].x * config.l1_mean;
        let ssim = rows[0].y * config.ssim_mean;
        let difference = config.l1_weight * l1 + config.l2_weight * rows[0].z * config.l1_mean;
        let loss = (1.0 - config.ssim_weight) * difference + config.ssim_weight * (1.0 - ssim);
        state.l1 = l1;
        state.ssim = ssim;
        state.loss = loss;
        if (!is_finite(loss) && state.halted == HALT_NONE) {
            state.halted = HALT_NOT_FINITE;
        }
    }
}
