//! The tensors of a state: names, shapes, and values piece by piece, in the order of the file.

use std::io;

use luxel_core::engine::{SavedPart, SplatArray};
use luxel_core::{ColorModel, SavedGroup, SavedState};
use safetensors::tensor::Dtype;

/// Bytes moved at a time: whole rows of three and of four values.
pub(super) const PIECE_BYTES: usize = 48 << 10;
/// Splats whose values are asked for at a time.
const PIECE_SPLATS: usize = 1 << 14;

/// The content of a tensor.
#[derive(Clone, Copy)]
enum Content {
    Array(SavedGroup, SplatArray),
    Gradient,
    AbsGradient,
    Views,
}

/// One tensor to write.
pub(super) struct Tensor {
    pub(super) name: String,
    pub(super) shape: Vec<usize>,
    content: Content,
}

const GROUPS: [(&str, SavedGroup); 3] = [
    ("splats", SavedGroup::Engine(SavedPart::Parameters)),
    ("moments.first", SavedGroup::Engine(SavedPart::FirstMoments)),
    ("moments.second", SavedGroup::Engine(SavedPart::SecondMoments)),
];
const STATS: [(&str, Content); 3] =
    [("stats.gradient", Content::Gradient), ("stats.abs_gradient", Content::AbsGradient), ("stats.views", Content::Views)];

/// Group of the parameters' mean, last in the file where there is one.
pub(super) const AVERAGE: &str = "average";

/// Names and contents in the order of the file, with or without an average.
fn contents(is_averaged: bool) -> Vec<(String, Content)> {
    let arrays =
        |(name, group): (&str, SavedGroup)| SplatArray::ALL.map(|array| (format!("{name}.{}", array.name()), Content::Array(group, array)));
    let average = is_averaged.then_some((AVERAGE, SavedGroup::Average)).into_iter().flat_map(arrays);
    let stats = STATS.map(|(name, content)| (name.to_owned(), content));
    GROUPS.into_iter().flat_map(arrays).chain(stats).chain(average).collect()
}

/// Names in the order of the file, with or without an average.
pub(super) fn names(is_averaged: bool) -> Vec<String> {
    contents(is_averaged).into_iter().map(|(name, _)| name).collect()
}

/// Returns all tensors of a state.
///
/// # Errors
/// What the state cannot tell.
pub(super) fn tensors_of(state: &mut impl SavedState) -> io::Result<Vec<Tensor>> {
    let (n, color_model) = (state.splat_count(), state.scene().splats.color_model);
    let of_file = contents(state.is_averaged());
    let mut tensor = |(name, content)| {
        let is_absent = match content {
            Content::Array(group, array @ SplatArray::Smoothing) => values(state, group, array, 0..n.min(1))?.is_empty(),
            Content::Array(..) => false,
            Content::Gradient => state.stats().gradient.is_empty(),
            Content::AbsGradient => state.stats().abs_gradient.is_empty(),
            Content::Views => state.stats().views.is_empty(),
        };
        let shape = match content {
            _ if is_absent => vec![0],
            Content::Array(_, array) => shape(array, n, color_model),
            Content::Gradient | Content::AbsGradient | Content::Views => vec![n],
        };
        Ok(Tensor { name, shape, content })
    };
    of_file.into_iter().map(&mut tensor).collect()
}

fn shape(array: SplatArray, n: usize, color_model: ColorModel) -> Vec<usize> {
    match array {
        SplatArray::OpacityLogit | SplatArray::Smoothing => vec![n],
        SplatArray::Sh => vec![n, color_model.sh_coefficients(), 3],
        SplatArray::Position | SplatArray::Rotation | SplatArray::LogScale | SplatArray::RawLuminance => vec![n, array.width(color_model)],
    }
}

fn values<S: SavedState>(
    state: &mut S,
    group: SavedGroup,
    array: SplatArray,
    splats: std::ops::Range<usize>,
) -> io::Result<std::borrow::Cow<'_, [f32]>> {
    state.values(group, array, splats).map_err(io::Error::other)
}

impl Tensor {
    /// Returns the number of values.
    pub(super) fn len(&self) -> usize {
        self.shape.iter().product()
    }

    pub(super) fn dtype(&self) -> Dtype {
        if matches!(self.content, Content::Views) { Dtype::U32 } else { Dtype::F32 }
    }

    /// Visits the values' bytes, least significant first, piece by piece. Parameters that are not
    /// finite are errors.
    pub(super) fn for_each_piece(&self, state: &mut impl SavedState, mut each: impl FnMut(&[u8]) -> io::Result<()>) -> io::Result<()> {
        let (n, color_model) = (state.splat_count(), state.scene().splats.color_model);
        match self.content {
            _ if self.len() == 0 => Ok(()),
            Content::Gradient => pieces(&state.stats().gradient, f32::to_le_bytes, &mut each),
            Content::AbsGradient => pieces(&state.stats().abs_gradient, f32::to_le_bytes, &mut each),
            Content::Views => pieces(&state.stats().views, u32::to_le_bytes, &mut each),
            Content::Array(group, array) => (0..n).step_by(PIECE_SPLATS).try_for_each(|first| {
                let splats = first..n.min(first + PIECE_SPLATS);
                let (width, expected) = (array.width(color_model), splats.len() * array.width(color_model));
                let values = values(state, group, array, splats)?;
                if values.len() != expected {
                    return Err(io::Error::other(format!("{} has {} values of some splats, expected {expected}", self.name, values.len())));
                }
                if group == SavedGroup::Engine(SavedPart::Parameters) {
                    array.check_finite(&values, width, first).map_err(io::Error::other)?;
                }
                pieces(&values, f32::to_le_bytes, &mut each)
            }),
        }
    }
}

fn pieces<T: Copy>(values: &[T], to_bytes: fn(T) -> [u8; 4], each: &mut impl FnMut(&[u8]) -> io::Result<()>) -> io::Result<()> {
    let mut piece = [0u8; PIECE_BYTES];
    for part in values.chunks(PIECE_BYTES / 4) {
        for (to, value) in piece.as_chunks_mut::<4>().0.iter_mut().zip(part) {
            *to = to_bytes(*value);
        }
        each(&piece[..4 * part.len()])?;
    }
    Ok(())
}
