// Rays of pixels, for projections other than the pinhole. Twins: core/projection.rs,
// core/engine/pixel_angle.rs, cpu/rays.rs.

struct Lens {
    // k1 to k4 of a fisheye.
    coefficients: vec4f,
    // Squared side of a pixel in radians: a polynomial of (cosine - middle) * inverse_half_range.
    size_0: vec4f,
    size_1: vec4f,
    size_2: vec4f,
    middle: f32,
    inverse_half_range: f32,
    // Least cosine between a ray and the axis.
    least_cosine: f32,
    // The fisheye's field: angle to the axis, and its radius for a focal length of 1.
    max_angle: f32,
    max_radius: f32,
    // Largest growth of distances from the sphere to the plane of a fisheye.
    stretch: f32,
    is_panorama: u32,
    padding: u32,
}

@group(0) @binding(15) var<uniform> lens: Lens;

const HALF_PI = 1.5707963267948966;

// Sine and cosine to f32's precision: those of shaders may be off by 2^-11.
fn sin_cos(angle: f32) -> vec2f {
    let quarter = round(angle * (1.0 / HALF_PI));
    // The quarter turn in two parts, so that the difference keeps its digits.
    let x = (angle - quarter * 1.5703125) - quarter * 4.8382679e-4;
    let x2 = x * x;
    let s = x + x * x2 * (-0.16666667 + x2 * (8.3333310e-3 + x2 * (-1.9840874e-4 + x2 * 2.7525562e-6)));
    let c = 1.0 - 0.5 * x2 + x2 * x2 * (4.1666668e-2 + x2 * (-1.3888887e-3 + x2 * (2.4800996e-5 - x2 * 2.6051615e-7)));
    let n = i32(quarter) & 3;
    let turned = select(vec2f(s, c), vec2f(c, -s), (n & 1) == 1);
    return select(turned, -turned, n >= 2);
}

fn fisheye_radius(angle: f32) -> f32 {
    let k = lens.coefficients;
    let t2 = angle * angle;
    return angle * (1.0 + t2 * (k.x + t2 * (k.y + t2 * (k.z + t2 * k.w))));
}

fn fisheye_slope(angle: f32) -> f32 {
    let k = lens.coefficients;
    let t2 = angle * angle;
    return 1.0 + t2 * (3.0 * k.x + t2 * (5.0 * k.y + t2 * (7.0 * k.z + t2 * 9.0 * k.w)));
}

// Returns the angle at a radius within the field, by Newton's method within brackets.
fn fisheye_angle(radius: f32) -> f32 {
    var low = 0.0;
    var high = lens.max_angle;
    var angle = min(radius, high);
    for (var n = 0; n < 12; n++) {
        let excess = fisheye_radius(angle) - radius;
        if (excess > 0.0) {
            high = angle;
        } else {
            low = angle;
        }
        let newton = angle - excess / fisheye_slope(angle);
        angle = select(0.5 * (low + high), newton, newton >= low && newton <= high);
    }
    return angle;
}

// Returns the ray of a place of the image in camera space, a unit vector; zero where the image
// shows nothing.
fn ray_at(at_px: vec2f) -> vec3f {
    let plane = (at_px - camera.center_px) / camera.focal_px;
    if (lens.is_panorama != 0u) {
        if (abs(plane.y) > HALF_PI) {
            return vec3f(0.0);
        }
        let x = sin_cos(plane.x);
        let y = sin_cos(plane.y);
        return vec3f(x.x * y.y, y.x, x.y * y.y);
    }
    let radius = length(plane);
    if (radius > lens.max_radius) {
        return vec3f(0.0);
    }
    let turn = sin_cos(fisheye_angle(radius));
    let scale = select(0.0, turn.x / radius, radius > 0.0);
    return vec3f(plane * scale, turn.y);
}

// Returns the squared side of a pixel in radians at a cosine to the axis, and its derivative.
fn pixel_angle(cosine: f32) -> vec2f {
    let t = (cosine - lens.middle) * lens.inverse_half_range;
    let inside = abs(t) < 1.0;
    let x = clamp(t, -1.0, 1.0);
    var terms = array<vec4f, 3>(lens.size_0, lens.size_1, lens.size_2);
    var value = 0.0;
    var slope = 0.0;
    for (var n = 2; n >= 0; n--) {
        for (var k = 3; k >= 0; k--) {
            slope = slope * x + value;
            value = value * x + terms[n][k];
        }
    }
    return vec2f(value, select(0.0, slope * lens.inverse_half_range, inside));
}

// Two directions of the plane across a unit vector (Duff et al. 2017); `sign` is 1 where z is not
// negative, else -1.
struct PlaneBasis {
    x: vec3f,
    y: vec3f,
}

fn plane_basis(unit: vec3f, sign: f32) -> PlaneBasis {
    let a = -1.0 / (sign + unit.z);
    let b = unit.x * unit.y * a;
    return PlaneBasis(
        vec3f(1.0 + sign * unit.x * unit.x * a, sign * b, -sign * unit.x),
        vec3f(b, sign + unit.y * unit.y * a, -unit.y),
    );
}
