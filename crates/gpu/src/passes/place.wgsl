// The place of a splat on the image plane of a pinhole. Twin: cpu/passes/project.rs.

fn mean_of(p: Projection) -> vec2f {
    return p.at.point.xy / p.at.point.z * camera.focal_px + camera.center_px;
}

// Reports whether the ellipse at the squared radius `widest` reaches into the image.
fn may_reach_image(p: Projection, widest: f32) -> bool {
    let mean = mean_of(p);
    let reach = sqrt(vec2f(p.covariance.x, p.covariance.z) * widest);
    return all(mean + reach > vec2f(0.0)) && all(mean - reach < vec2f(camera.size_px));
}

// Writes the place of a footprint whose other fields are written; false if it is off the image or
// not finite.
fn place(p: Projection, root: vec3f, f: ptr<function, Footprint>) -> bool {
    let mean = mean_of(p);
    let radius2 = ((*f).log2_opacity - (*f).log2_threshold) * TWO_LN_2;
    let extent = sqrt(vec2f(p.covariance.x, p.covariance.z) * max(radius2, 0.0));
    (*f).mean_px = mean;
    (*f).root_x = root.x;
    (*f).root_xy = root.y;
    (*f).root_y = root.z;
    (*f).extent_y_px = extent.y;
    (*f).right_dy_px = extent.x * p.covariance.y / p.covariance.x;
    // Pixel centres lie between 1/2 and size - 1/2.
    return all(mean + extent > vec2f(0.5)) && all(mean - extent < vec2f(camera.size_px) - 0.5) && extent.x + extent.y < 1e9;
}
