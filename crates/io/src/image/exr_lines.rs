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

use super::exr_options::{ExrOptions, ExrPlane, ExrSample, PlaneValues, to_half};

/// The channels, by name as OpenEXR has them.
pub(super) struct ImageChannels<'a> {
    image: &'a Image,
    channels: Vec<Channel<'a>>,
}

/// A channel, and the value of each pixel.
struct Channel<'a> {
    name: &'a str,
    sample: SampleType,
    values: Values<'a>,
}

/// The source of a channel's values.
enum Values<'a> {
    Color(usize),
    Single(&'a [f32]),
    Axis(&'a [[f32; 3]], usize),
    Whole(&'a [u32]),
}

impl Values<'_> {
    /// Returns the bits of a pixel's value of 32 bits.
    fn bits(&self, image: &Image, pixel: usize) -> u32 {
        match self {
            Values::Color(c) => image.pixels[pixel][*c].to_bits(),
            Values::Single(values) => values[pixel].to_bits(),
            Values::Axis(normals, c) => normals[pixel][*c].to_bits(),
            Values::Whole(values) => values[pixel],
        }
    }
}

impl<'a> ImageChannels<'a> {
    /// Returns the channels of an image, all of whose planes have as many values as it has pixels.
    pub(super) fn new(image: &'a Image, options: &'a ExrOptions) -> Self {
        let ExrOptions { sample, alpha, depth, normals, planes, .. } = options;
        let sample = if *sample == ExrSample::Half { SampleType::F16 } else { SampleType::F32 };
        let color = |name, c| Some(Channel { name, sample, values: Values::Color(c) });
        let single = |name, sample, values: &'a Option<Vec<f32>>| {
            values.as_deref().map(|values| Channel { name, sample, values: Values::Single(values) })
        };
        let axis = |name, c| normals.as_deref().map(|normals| Channel { name, sample: SampleType::F32, values: Values::Axis(normals, c) });
        let all = [
            single("A", sample, alpha),
            color("B", 2),
            color("G", 1),
            axis("N.X", 0),
            axis("N.Y", 1),
            axis("N.Z", 2),
            color("R", 0),
            single("Z", SampleType::F32, depth),
        ];
        let plane = |plane: &'a ExrPlane| match &plane.values {
            PlaneValues::Float(values) => Channel { name: &plane.name, sample: SampleType::F32, values: Values::Single(values) },
            PlaneValues::Whole(values) => Channel { name: &plane.name, sample: SampleType::U32, values: Values::Whole(values) },
        };
        let mut channels: Vec<Channel<'_>> = all.into_iter().flatten().chain(planes.iter().map(plane)).collect();
        channels.sort_by(|a, b| a.name.cmp(b.name));
        Self { image, channels }
    }

    /// Fills a line.
    fn fill(&self, line: LineRefMut<'_>) {
        let Some(channel) = self.channels.get(line.location.channel) else { return };
        let first = line.location.position.1 * self.image.width + line.location.position.0;
        match channel.sample {
            SampleType::F16 => {
                let places = line.value.as_chunks_mut::<2>().0.iter_mut();
                let value = |i| f32::from_bits(channel.values.bits(self.image, first + i));
                places.enumerate().for_each(|(i, place)| *place = to_half(value(i)).to_ne_bytes());
            }
            SampleType::F32 | SampleType::U32 => {
                let places = line.value.as_chunks_mut::<4>().0.iter_mut();
                places.enumerate().for_each(|(i, place)| *place = channel.values.bits(self.image, first + i).to_ne_bytes());
            }
        }
    }
}

impl<'slf> WritableChannels<'slf> for ImageChannels<'slf> {
    type Writer = &'slf Self;

    fn infer_channel_list(&self) -> ChannelList {
        let described = |channel: &Channel<'_>| ChannelDescription::named(channel.name, channel.sample);
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
