//! Triangle meshes with normals and radiance.

/// A triangle mesh. Seen from its free side, the corners of a triangle go round counter-clockwise.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct TriangleMesh {
    /// Vertices, `[V,3]`.
    pub positions: Vec<[f32; 3]>,
    /// Unit vectors towards the free side, `[V,3]`.
    pub normals: Vec<[f32; 3]>,
    /// Linear radiance in the unit of the images, `[V,3]`.
    pub radiance: Vec<[f32; 3]>,
    /// Numbers of vertices, `[T,3]`.
    pub triangles: Vec<[u32; 3]>,
}

impl TriangleMesh {
    /// Returns the lower and upper corner of the box along the axes that holds all vertices; zeros
    /// without any.
    pub fn bounds(&self) -> [[f32; 3]; 2] {
        let join = |[low, high]: [[f32; 3]; 2], p: &[f32; 3]| [[0, 1, 2].map(|c| low[c].min(p[c])), [0, 1, 2].map(|c| high[c].max(p[c]))];
        self.positions.first().map_or([[0.0; 3]; 2], |first| self.positions.iter().fold([*first; 2], join))
    }

    /// Keeps some of the triangles, and the vertices that they use, in the order of their numbers.
    pub(crate) fn keep(&mut self, is_kept: impl Fn(&[u32; 3]) -> bool) {
        self.triangles.retain(is_kept);
        let mut number = vec![u32::MAX; self.positions.len()];
        self.triangles.as_flattened().iter().for_each(|vertex| number[*vertex as usize] = 0);
        let used: Vec<usize> = (0..number.len()).filter(|vertex| number[*vertex] == 0).collect();
        for (new, old) in used.iter().enumerate() {
            number[*old] = new as u32;
        }
        self.triangles.as_flattened_mut().iter_mut().for_each(|vertex| *vertex = number[*vertex as usize]);
        for rows in [&mut self.positions, &mut self.normals, &mut self.radiance] {
            *rows = used.iter().map(|vertex| rows[*vertex]).collect();
        }
    }
}
