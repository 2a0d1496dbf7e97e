// The place of a splat among rays: the variant of place.wgsl. Twin: cpu/passes/project_rays.rs.

// Reports whether the ellipse at the squared radius `widest` reaches into the field.
fn may_reach_image(p: Projection, widest: f32) -> bool {
    return p.at.unit.z + sqrt((p.covariance.x + p.covariance.z) * widest) >= lens.least_cosine;
}

// Writes the place of a footprint whose other fields are written.
fn place(p: Projection, root: vec3f, f: ptr<function, Footprint>) -> bool {
    (*f).mean_px = encode_direction(p.at.unit);
    (*f).root_x = p.at.sign * root.x;
    (*f).root_xy = root.y;
    (*f).root_y = root.z;
    return true;
}
