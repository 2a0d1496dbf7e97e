//! Colour spaces of an OpenColorIO configuration: files of radiance in one of them come to ACES2065-1, and from there to the scene's space.
//!
//! In: a configuration and the name of a space in it. Out: [`OcioSpace`]. The way to ACES2065-1 is the configuration's role `aces_interchange`, or its
//! space of that name. A configuration is a stranger's file: panics of the library are contained.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::Path;

use anyhow::{Context, Result, anyhow, bail};
use luxel_core::{ColorSpace, Conversion, Image};
use ocio::Config;
use ocio::processor::CpuProcessor;
use rayon::prelude::*;

/// What leads to ACES2065-1.
const INTERCHANGE: [&str; 2] = ["aces_interchange", "ACES2065-1"];
/// Pixels that are converted at a time.
const CHUNK: usize = 1 << 14;

/// From one space of a configuration to linear light.
pub(super) struct OcioSpace {
    aces_from_input: CpuProcessor,
    /// For keys of what was made with it.
    pub(super) key: String,
}

impl OcioSpace {
    /// Reads the configuration.
    pub(super) fn open(config: &Path, space: &str) -> Result<Self> {
        let path = config.to_str().with_context(|| format!("{}: expected a name in UTF-8", config.display()))?;
        let open = || -> Result<CpuProcessor> {
            let parsed = Config::create_from_file(path).map_err(|e| anyhow!("{e}"))?;
            let interchange = INTERCHANGE.into_iter().find(|name| parsed.has_role(name) || parsed.get_color_space(name).is_some());
            let Some(interchange) = interchange else {
                bail!("no role aces_interchange and no space ACES2065-1, expected one of them to know what its colours are");
            };
            if parsed.get_color_space(space).is_none() {
                bail!("no colour space \"{space}\"; say one of the configuration's with --ocio-space");
            }
            let processor = parsed.get_processor(space, interchange).map_err(|e| anyhow!("from {space} to {interchange}: {e}"))?;
            Ok(processor.default_cpu_processor())
        };
        // Nothing outlives a panic in there.
        let opened =
            catch_unwind(AssertUnwindSafe(open)).unwrap_or_else(|_| Err(anyhow!("OpenColorIO failed on it; it is probably damaged")));
        let aces_from_input = opened.map_err(|e| anyhow!("{}: {e}", config.display()))?;
        let content = std::fs::read(config).with_context(|| format!("{}: cannot read", config.display()))?;
        Ok(Self { aces_from_input, key: format!("{} {space}", blake3::hash(&content).to_hex()) })
    }

    /// Converts radiance to `space`.
    pub(super) fn convert(&self, image: &mut Image, space: ColorSpace) {
        let conversion = Conversion::between(ColorSpace::Aces2065, space);
        image.pixels.par_chunks_mut(CHUNK).for_each(|pixels| {
            self.aces_from_input.apply_rgb_slice(pixels.as_flattened_mut());
            pixels.iter_mut().for_each(|p| *p = conversion.apply(*p));
        });
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const CONFIG: &str = "ocio_profile_version: 2\nsearch_path: \"\"\nroles:\n  default: raw\n  aces_interchange: ACES2065-1\n\
        displays:\n  sRGB:\n    - !<View> {name: Raw, colorspace: raw}\nactive_displays: []\nactive_views: []\ncolorspaces:\n  \
        - !<ColorSpace>\n    name: raw\n    isdata: true\n  - !<ColorSpace>\n    name: ACES2065-1\n  - !<ColorSpace>\n    name: half\n    \
        to_scene_reference: !<MatrixTransform> {matrix: [0.5, 0, 0, 0, 0, 0.5, 0, 0, 0, 0, 0.5, 0, 0, 0, 0, 1]}\n";

    fn open(content: &str, space: &str) -> Result<OcioSpace> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("config.ocio");
        std::fs::write(&path, content).unwrap();
        OcioSpace::open(&path, space)
    }

    #[test]
    fn a_space_of_a_configuration_comes_to_the_scenes() {
        let space = open(CONFIG, "half").unwrap();
        let mut image = Image::filled(3, 2, [2.0, 1.0, 4000.0]);
        space.convert(&mut image, ColorSpace::Aces2065);
        assert_eq!(image.at(1, 1), [1.0, 0.5, 2000.0]);
        let mut grey = Image::filled(1, 1, [0.36; 3]);
        space.convert(&mut grey, ColorSpace::LinearRec709);
        assert!(grey.at(0, 0).iter().all(|v| (v - 0.18).abs() < 1e-5), "{:?}", grey.at(0, 0));
    }

    #[test]
    fn what_is_wrong_with_a_configuration_is_said() {
        for (content, space, part) in [
            (CONFIG, "nowhere", "no colour space \"nowhere\""),
            ("not: [yaml", "half", "config.ocio: "),
            (
                &CONFIG.replace("aces_interchange: ACES2065-1", "scene_linear: half").replace("name: ACES2065-1", "name: other"),
                "half",
                "no role aces_interchange",
            ),
        ] {
            let error = open(content, space).err().unwrap().to_string();
            assert!(error.contains(part), "{part}: {error}");
        }
    }
}
