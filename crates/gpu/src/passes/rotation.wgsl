// Rotations by unit quaternions (w, x, y, z).

// Returns the rows of the rotation matrix.
fn rotation_rows(q: vec4f) -> array<vec3f, 3> {
    let w = q.x;
    let x = q.y;
    let y = q.z;
    let z = q.w;
    return array<vec3f, 3>(
        vec3f(1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)),
        vec3f(2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)),
        vec3f(2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)),
    );
}
