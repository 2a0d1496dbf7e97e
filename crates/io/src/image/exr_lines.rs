//! The channels of an image to be written, taken from its pixels line by line: a file is made
//! without a copy of the image.

use ::exr::block::lines::LineRefMut;
use ::exr::block::{BlockIndex, UncompressedBlock};
use ::exr::image::write::channels::{ChannelsWriter, WritableChannels};
use ::exr::math::RoundingMode;
use ::exr::meta::attribute::{ChannelDescription, ChannelList, LevelMode, SampleType};
use ::exr::meta::header::Header;
use ::exr::prelude::SmallVec;
use luxel_core::Image;

use super::exr_options::{ExrOptions, ExrSample, to_half};

/// The channels, by name as OpenEXR has them.
pub(super) struct ImageChannels<'a> {
    image: &'a Image,
    channels: Vec<Channel<'a>>,
}

/// A channel, and the value of each pixel.
struct Channel<'a> {
    name: &'static str,
    sample: ExrSample,
    values: Values<'a>,
}

/// The source of a channel's values.
enum Values<'a> {
    Color(usize),
    Single(&'a [f32]),
    Axis(&'a [[f32; 3]], usize),
}

impl<'a> ImageChannels<'a> {
    /// Returns the channels of an image, all of whose planes have as many values as it has pixels.
    pub(super) fn new(image: &'a Image, options: &'a ExrOptions) -> Self {
        let ExrOptions { sample, alpha, depth, normals, .. } = options;
        let color = |name, c| Some(Channel { name, sample: *sample, values: Values::Color(c) });
        let single = |name, sample, values: &'a Option<Vec<f32>>| {
            values.as_deref().map(|values| Channel { name, sample, values: Values::Single(values) })
        };
        let axis = |name, c| normals.as_deref().map(|normals| Channel { name, sample: ExrSample::Float, values: Values::Axis(normals, c) });
        let all = [
            single("A", *sample, alpha),
            color("B", 2),
            color("G", 1),
            axis("N.X", 0),
            axis("N.Y", 1),
            axis("N.Z", 2),
            color("R", 0),
            single("Z", ExrSample::Float, depth),
        ];
        Self { image, channels: all.into_iter().flatten().collect() }
    }

    fn value(&self, channel: &Channel<'_>, pixel: usize) -> f32 {
        match channel.values {
            Values::Color(c) => self.image.pixels[pixel][c],
            Values::Single(values) => values[pixel],
            Values::Axis(normals, c) => normals[pixel][c],
        }
    }

    /// Fills a line.
    fn fill(&self, line: LineRefMut<'_>) {
        let Some(channel) = self.channels.get(line.location.channel) else { return };
        let first = line.location.position.1 * self.image.width + line.location.position.0;
        match channel.sample {
            ExrSample::Half => {
                let places = line.value.as_chunks_mut::<2>().0.iter_mut();
                places.enumerate().for_each(|(i, place)| *place = to_half(self.value(channel, first + i)).to_ne_bytes());
            }
            ExrSample::Float => {
                let places = line.value.as_chunks_mut::<4>().0.iter_mut();
                places.enumerate().for_each(|(i, place)| *place = self.value(channel, first + i).to_ne_bytes());
            }
        }
    }
}

impl<'slf> WritableChannels<'slf> for ImageChannels<'slf> {
    type Writer = &'slf Self;

    fn infer_channel_list(&self) -> ChannelList {
        let described = |channel: &Channel<'_>| {
            let kind = if channel.sample == ExrSample::Half { SampleType::F16 } else { SampleType::F32 };
            ChannelDescription::named(channel.name, kind)
        };
        ChannelList::new(self.channels.iter().map(described).collect::<SmallVec<_>>())
    }

    fn infer_level_modes(&self) -> (LevelMode, RoundingMode) {
        (LevelMode::Singular, RoundingMode::Down)
    }

    fn create_writer(&'slf self, _: &Header) -> Self::Writer {
        self
    }
}

impl ChannelsWriter for &ImageChannels<'_> {
    fn extract_uncompressed_block(&self, header: &Header, block: BlockIndex) -> Vec<u8> {
        UncompressedBlock::collect_block_data_from_lines(&header.channels, block, |line| self.fill(line))
    }
}
