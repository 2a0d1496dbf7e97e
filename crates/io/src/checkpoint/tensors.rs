//! The tensors of a snapshot: names, shapes and borrowed values, in the order of the file.

use luxel_core::{Snapshot, Splats};
use safetensors::tensor::Dtype;

/// Bytes moved at a time: whole rows of three and of four values.
pub(super) const PIECE_BYTES: usize = 48 << 10;

/// Values of one tensor.
pub(super) enum Values<'a> {
    F32(&'a [f32]),
    U32(&'a [u32]),
}

impl Values<'_> {
    pub(super) fn len(&self) -> usize {
        match self {
            Self::F32(values) => values.len(),
            Self::U32(values) => values.len(),
        }
    }

    pub(super) fn is_empty(&self) -> bool {
        self.len() == 0
    }

    pub(super) fn dtype(&self) -> Dtype {
        match self {
            Self::F32(_) => Dtype::F32,
            Self::U32(_) => Dtype::U32,
        }
    }

    /// Visits the values' bytes, least significant first, piece by piece.
    pub(super) fn for_each_piece(&self, mut each: impl FnMut(&[u8]) -> std::io::Result<()>) -> std::io::Result<()> {
        fn pieces<T: Copy>(
            values: &[T],
            to_bytes: fn(T) -> [u8; 4],
            each: &mut impl FnMut(&[u8]) -> std::io::Result<()>,
        ) -> std::io::Result<()> {
            let mut piece = [0u8; PIECE_BYTES];
            for part in values.chunks(PIECE_BYTES / 4) {
                for (to, value) in piece.as_chunks_mut::<4>().0.iter_mut().zip(part) {
                    *to = to_bytes(*value);
                }
                each(&piece[..4 * part.len()])?;
            }
            Ok(())
        }
        match self {
            Self::F32(values) => pieces(values, f32::to_le_bytes, &mut each),
            Self::U32(values) => pieces(values, u32::to_le_bytes, &mut each),
        }
    }
}

/// One tensor to write.
pub(super) struct Tensor<'a> {
    pub(super) name: String,
    /// Shape that it must have.
    pub(super) shape: Vec<usize>,
    /// Whether it may be empty instead.
    pub(super) is_optional: bool,
    pub(super) values: Values<'a>,
}

const SPLATS: [&str; 7] = ["position", "rotation", "log_scale", "opacity_logit", "sh", "raw_luminance", "smoothing"];
const GROUPS: [&str; 3] = ["splats", "moments.first", "moments.second"];
const STATS: [&str; 3] = ["stats.gradient", "stats.abs_gradient", "stats.views"];

/// Group of the parameters' mean, last in the file where there is one.
pub(super) const AVERAGE: &str = "average";

/// Names in the order of the file, with or without an average.
pub(super) fn names(is_averaged: bool) -> Vec<String> {
    let group = |group: &str| SPLATS.map(|array| format!("{group}.{array}"));
    let average = is_averaged.then(|| group(AVERAGE)).into_iter().flatten();
    GROUPS.into_iter().flat_map(group).chain(STATS.map(str::to_owned)).chain(average).collect()
}

/// Returns all tensors of a snapshot.
pub(super) fn tensors_of(snapshot: &Snapshot) -> Vec<Tensor<'_>> {
    let (splats, moments, stats) = (&snapshot.scene.splats, &snapshot.moments, &snapshot.stats);
    let n = splats.len();
    let values = [splats, &moments.first, &moments.second].into_iter().flat_map(|group| arrays(group, n));
    let optional = |values| (vec![n], true, values);
    let stats = [Values::F32(&stats.gradient), Values::F32(&stats.abs_gradient), Values::U32(&stats.views)].map(optional);
    let average = snapshot.average.iter().flat_map(|average| arrays(average, n));
    names(snapshot.average.is_some())
        .into_iter()
        .zip(values.chain(stats).chain(average))
        .map(|(name, (shape, is_optional, values))| Tensor { name, shape, is_optional, values })
        .collect()
}

/// Returns the shape, whether it may be empty instead, and values, in the order of [`SPLATS`].
fn arrays(splats: &Splats, n: usize) -> [(Vec<usize>, bool, Values<'_>); 7] {
    let (k, m) = (splats.color_model.sh_coefficients(), splats.color_model.luminance_coefficients());
    [
        (vec![n, 3], false, Values::F32(splats.position.as_flattened())),
        (vec![n, 4], false, Values::F32(splats.rotation.as_flattened())),
        (vec![n, 3], false, Values::F32(splats.log_scale.as_flattened())),
        (vec![n], false, Values::F32(&splats.opacity_logit)),
        (vec![n, k, 3], false, Values::F32(&splats.sh)),
        (vec![n, m], false, Values::F32(&splats.raw_luminance)),
        (vec![n], true, Values::F32(&splats.smoothing)),
    ]
}
