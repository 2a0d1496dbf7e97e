//! The factor by which images are reduced as they are read: given, or chosen by their sizes.
//!
//! In: the images to train on, by their headers. Out: a whole factor for all images of the data
//! set, so that views of one scene keep one sampling. A block has the factor of its whole data set,
//! so that blocks go together. Degenerate: without an image to train on, or one whose header can be
//! read, the factor is 1, and reading the images says what is wrong.

use std::fmt;
use std::path::Path;
use std::str::FromStr;

use serde::de::{Deserializer, Error, Visitor};
use serde::{Deserialize, Serialize, Serializer};

use super::assemble::{Arranged, indices_of, supervised};
use super::selected::{Role, Split, select};
use super::source::DatasetSource;
use super::split::Part;
use super::{Block, LoadOptions, read_source};
use crate::IoError;
use crate::image::image_size;

/// The longer side of images that [`Downscale::Auto`] leaves as they are, pixels: what programs for
/// radiance fields commonly train on.
pub const AUTO_SIDE_PX: u32 = 1600;

/// The largest factor.
pub const MAX_DOWNSCALE: u32 = 16;

/// Name of [`Downscale::Auto`].
const AUTO: &str = "auto";
const EXPECTED: &str = "auto or a whole number from 1 to 16";

/// By how much images are reduced along each side as they are read. In files and on command lines
/// it is a number, or `auto`.
///
/// ```
/// use luxel_io::Downscale;
///
/// assert_eq!("3".parse(), Ok(Downscale::By(3)));
/// assert_eq!(Downscale::default(), Downscale::FULL_SIZE);
/// assert!("17".parse::<Downscale>().is_err());
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Downscale {
    /// The smallest whole factor with which the longer side of the largest image to train on is at
    /// most [`AUTO_SIDE_PX`], at most [`MAX_DOWNSCALE`].
    Auto,
    /// This factor, 1 to [`MAX_DOWNSCALE`].
    By(u32),
}

impl Downscale {
    /// Images as they are.
    pub const FULL_SIZE: Self = Self::By(1);

    /// Returns the factor, once it is known; before, that of images which stay as they are.
    pub(super) fn factor(self) -> u32 {
        match self {
            Self::Auto => 1,
            Self::By(factor) => factor,
        }
    }

    /// Refuses a factor out of range.
    pub(super) fn check(self, path: &Path) -> Result<(), IoError> {
        match self {
            Self::By(factor) if !is_factor(factor) => Err(IoError::invalid(path, format!("reduction by {factor}, expected {EXPECTED}"))),
            Self::Auto | Self::By(_) => Ok(()),
        }
    }
}

fn is_factor(number: u32) -> bool {
    (1..=MAX_DOWNSCALE).contains(&number)
}

/// Full size.
impl Default for Downscale {
    fn default() -> Self {
        Self::FULL_SIZE
    }
}

impl From<u32> for Downscale {
    fn from(factor: u32) -> Self {
        Self::By(factor)
    }
}

impl fmt::Display for Downscale {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Auto => f.pad(AUTO),
            Self::By(factor) => factor.fmt(f),
        }
    }
}

impl FromStr for Downscale {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        if text == AUTO {
            return Ok(Self::Auto);
        }
        let factor = text.parse().ok().filter(|factor| is_factor(*factor));
        factor.map(Self::By).ok_or_else(|| format!("expected {EXPECTED}, got \"{text}\""))
    }
}

impl Serialize for Downscale {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        match self {
            Self::Auto => serializer.serialize_str(AUTO),
            Self::By(factor) => serializer.serialize_u32(*factor),
        }
    }
}

impl<'de> Deserialize<'de> for Downscale {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_any(DownscaleVisitor)
    }
}

/// Takes a number or a name.
struct DownscaleVisitor;

impl Visitor<'_> for DownscaleVisitor {
    type Value = Downscale;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(EXPECTED)
    }

    fn visit_u64<E: Error>(self, number: u64) -> Result<Downscale, E> {
        let factor = u32::try_from(number).ok().filter(|factor| is_factor(*factor));
        factor.map(Downscale::By).ok_or_else(|| E::custom(format!("reduction by {number}, expected {EXPECTED}")))
    }

    fn visit_i64<E: Error>(self, number: i64) -> Result<Downscale, E> {
        u64::try_from(number).map_or_else(|_| Err(E::custom(format!("reduction by {number}, expected {EXPECTED}"))), |n| self.visit_u64(n))
    }

    fn visit_str<E: Error>(self, text: &str) -> Result<Downscale, E> {
        text.parse().map_err(E::custom)
    }
}

/// The reduction that [`Downscale::Auto`] comes to for a data set.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ChosenDownscale {
    /// The factor.
    pub factor: u32,
    /// Size of the largest image to train on before its reduction, the one with the longest side,
    /// pixels; zeros without one.
    pub largest_px: [u32; 2],
}

impl ChosenDownscale {
    /// Returns the choice for images of these sizes.
    fn of(sizes: impl Iterator<Item = [u32; 2]>) -> Self {
        // Of several with one longest side, the first.
        let longer = |size: [u32; 2]| size[0].max(size[1]);
        let largest_px = sizes.fold([0; 2], |largest, size| if longer(size) > longer(largest) { size } else { largest });
        // A reduction leaves the last pixels out that fill no block.
        let fits = |factor: &u32| longer(largest_px) / factor <= AUTO_SIDE_PX;
        Self { factor: (1..MAX_DOWNSCALE).find(fits).unwrap_or(MAX_DOWNSCALE), largest_px }
    }

    /// Returns the size of the largest image after its reduction, pixels.
    pub fn reduced_px(&self) -> [u32; 2] {
        self.largest_px.map(|side| side / self.factor)
    }
}

/// Chooses the reduction of a data set by the headers of its images to train on, whatever
/// `options.downscale` is. Images that cannot be read are left out.
///
/// # Errors
/// Cameras or a split that cannot be read, like [`super::load_dataset`].
pub fn choose_downscale(path: &Path, options: &LoadOptions) -> Result<ChosenDownscale, IoError> {
    let block = Block::read(path)?;
    let whole = block.map_or_else(|| Ok(path.to_owned()), |block| block.whole(path))?;
    let DatasetSource { frames, split, .. } = read_source(&whole, options)?;
    let frames = supervised(&whole, frames, &split, options)?;
    let Arranged { sorted, order, parts } = Arranged::new(&frames, &split)?;
    let train = indices_of(&parts, Some(Part::Train));
    if train.is_empty() {
        return Ok(ChosenDownscale::of(std::iter::empty()));
    }
    let split = Split { frames: &sorted, order: &order, train: &train, test: &[] };
    let images = select(&whole, &split, options)?;
    let of_training = images.iter().filter(|image| matches!(image.role, Role::Train | Role::Captured));
    Ok(ChosenDownscale::of(of_training.filter_map(|image| image_size(&image.frame.image).ok())))
}

/// Returns the options with a number for the reduction, which [`Downscale::Auto`] asks to choose.
pub(super) fn resolved(path: &Path, options: &LoadOptions) -> Result<LoadOptions, IoError> {
    let downscale = match options.downscale {
        Downscale::Auto => Downscale::By(choose_downscale(path, options)?.factor),
        given => given,
    };
    Ok(LoadOptions { downscale, ..options.clone() })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn factor(sizes: &[[u32; 2]]) -> u32 {
        ChosenDownscale::of(sizes.iter().copied()).factor
    }

    #[test]
    fn the_longer_side_of_the_largest_image_comes_to_at_most_1600_pixels() {
        assert_eq!([1599, 1600].map(|width| factor(&[[width, 1200]])), [1, 1]);
        // 1601 / 1 is above it, 1601 / 2 is 800.
        assert_eq!(factor(&[[1601, 1200]]), 2);
        assert_eq!([factor(&[[4000, 3000]]), factor(&[[3000, 4000]])], [3, 3]);
        // One factor for all: that of the largest image, in whichever place.
        assert_eq!(factor(&[[800, 600], [3000, 4000], [1600, 1200]]), 3);
        // 3201 / 2 leaves the last column out: 1600.
        assert_eq!([3200, 3201, 3202].map(|side| factor(&[[side, 20]])), [2, 2, 3]);
        assert_eq!([25_600, 40_000].map(|side| factor(&[[side, 20]])), [16, 16]);
        let chosen = ChosenDownscale::of([[4000, 3000]].into_iter());
        assert_eq!((chosen.largest_px, chosen.reduced_px()), ([4000, 3000], [1333, 1000]));
        assert_eq!(ChosenDownscale::of(std::iter::empty()), ChosenDownscale { factor: 1, largest_px: [0; 2] });
    }

    #[test]
    fn it_is_a_number_or_auto_in_text_and_files() {
        for (text, expected) in [("auto", Downscale::Auto), ("1", Downscale::By(1)), ("3", Downscale::By(3)), ("16", Downscale::By(16))] {
            assert_eq!(text.parse(), Ok(expected));
            assert_eq!(expected.to_string(), text);
            let json = serde_json::to_string(&expected).unwrap();
            assert_eq!(serde_json::from_str::<Downscale>(&json).unwrap(), expected);
        }
        assert_eq!([Downscale::By(3), Downscale::Auto].map(|of| serde_json::to_string(&of).unwrap()), ["3", "\"auto\""]);
        for bad in ["0", "17", "-2", "1.5", "Auto", ""] {
            let error = bad.parse::<Downscale>().unwrap_err();
            assert_eq!(error, format!("expected auto or a whole number from 1 to 16, got \"{bad}\""));
        }
        for bad in ["0", "17", "-2", "1.5", "\"half\"", "true", "4294967298"] {
            let error = serde_json::from_str::<Downscale>(bad).unwrap_err().to_string();
            assert!(error.contains("expected auto or a whole number from 1 to 16"), "{bad}: {error}");
        }
    }
}
