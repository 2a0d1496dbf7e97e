//! Colour spaces of an OpenColorIO configuration: radiance in one of them comes to ACES2065-1, and
//! from there to the scene's space.

use std::path::{Path, PathBuf};

use ::ocio::processor::CpuProcessor;
use luxel_core::{ColorSpace, Conversion, Image};
use rayon::prelude::*;

use super::{CHUNK, content, listed};
use crate::IoError;
use crate::image::guard::contain;

/// From one space of a configuration to linear light.
pub struct OcioSpace {
    config: PathBuf,
    aces_from_input: CpuProcessor,
    digest: String,
}

impl OcioSpace {
    /// Reads the configuration.
    ///
    /// # Errors
    /// No such file, one that is damaged, without the space, or without a way to ACES2065-1.
    pub fn open(config: &Path, space: &str) -> Result<Self, IoError> {
        let content = content(config)?;
        let invalid = |message: String| IoError::invalid(config, message);
        let aces_from_input = contain(config, || {
            let (parsed, interchange) = content.parse()?;
            if parsed.get_color_space(space).is_none() {
                let named = listed(parsed.num_color_spaces(), |i| parsed.color_space_name_by_index(i).to_owned());
                return Err(invalid(format!("no colour space \"{space}\", expected one of the configuration's: {named}")));
            }
            let processor = parsed.get_processor(space, interchange);
            processor.map(|p| p.default_cpu_processor()).map_err(|e| invalid(format!("from {space} to {interchange}: {e}")))
        })?;
        Ok(Self { config: config.to_owned(), aces_from_input, digest: content.digest(space) })
    }

    /// Returns the digest of configuration and space, for keys of images that were made with them.
    pub fn digest(&self) -> &str {
        &self.digest
    }

    /// Converts radiance to `space`.
    ///
    /// # Errors
    /// The library failed on it.
    pub fn convert(&self, image: &mut Image, space: ColorSpace) -> Result<(), IoError> {
        let conversion = Conversion::between(ColorSpace::Aces2065, space);
        image.pixels.par_chunks_mut(CHUNK).try_for_each(|pixels| {
            contain(&self.config, || {
                self.aces_from_input.apply_rgb_slice(pixels.as_flattened_mut());
                pixels.iter_mut().for_each(|p| *p = conversion.apply(*p));
                Ok(())
            })
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const CONFIG: &str = "ocio_profile_version: 2\nsearch_path: \"\"\nroles:\n  default: raw\n  aces_interchange: ACES2065-1\n\
        displays:\n  sRGB:\n    - !<View> {name: Raw, colorspace: raw}\nactive_displays: []\nactive_views: []\ncolorspaces:\n  \
        - !<ColorSpace>\n    name: raw\n    isdata: true\n  - !<ColorSpace>\n    name: ACES2065-1\n  - !<ColorSpace>\n    name: half\n    \
        to_scene_reference: !<MatrixTransform> {matrix: [0.5, 0, 0, 0, 0, 0.5, 0, 0, 0, 0, 0.5, 0, 0, 0, 0, 1]}\n";

    fn open(content: &str, space: &str) -> Result<OcioSpace, IoError> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("config.ocio");
        std::fs::write(&path, content).unwrap();
        OcioSpace::open(&path, space)
    }

    #[test]
    fn a_space_of_a_configuration_comes_to_the_scenes() {
        let space = open(CONFIG, "half").unwrap();
        let mut image = Image::filled(3, 2, [2.0, 1.0, 4000.0]);
        space.convert(&mut image, ColorSpace::Aces2065).unwrap();
        assert_eq!(image.at(1, 1), [1.0, 0.5, 2000.0]);
        let mut grey = Image::filled(1, 1, [0.36; 3]);
        space.convert(&mut grey, ColorSpace::LinearRec709).unwrap();
        assert!(grey.at(0, 0).iter().all(|v| (v - 0.18).abs() < 1e-5), "{:?}", grey.at(0, 0));
    }

    #[test]
    fn a_configuration_that_is_built_in_has_the_primaries_of_acescg() {
        let space = OcioSpace::open(Path::new("ocio://cg-config-v1.0.0_aces-v1.3_ocio-v2.1"), "ACEScg").unwrap();
        let mut image = Image::filled(2, 2, [0.3, 2.0, 70.0]);
        space.convert(&mut image, ColorSpace::AcesCg).unwrap();
        assert!(image.at(1, 1).iter().zip([0.3, 2.0, 70.0]).all(|(v, t)| (v / t - 1.0).abs() < 1e-4), "{:?}", image.at(1, 1));
    }

    #[test]
    fn damage_is_an_error_or_a_conversion() {
        let whole = CONFIG.as_bytes();
        let mut bytes = whole.to_vec();
        for i in (0..whole.len()).step_by(3) {
            let _ = open(&CONFIG[..i], "half");
            // One byte of the file is another one's.
            bytes[i] = whole[(i * 31 + 7) % whole.len()];
            if let Ok(space) = open(&String::from_utf8_lossy(&bytes), "half") {
                let _ = space.convert(&mut Image::filled(2, 1, [f32::NAN, -1.0, 7e4]), ColorSpace::LinearRec709);
            }
            bytes[i] = whole[i];
        }
    }

    #[test]
    fn what_is_wrong_with_a_configuration_is_said() {
        for (content, space, part) in [
            (CONFIG, "nowhere", "no colour space \"nowhere\", expected one of the configuration's: raw, ACES2065-1, half"),
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
        let repeated = format!("a: &a1 [x]\nb: [{}]\n{CONFIG}", "*a1, ".repeat(9));
        let error = open(&repeated, "half").err().unwrap().to_string();
        assert!(error.contains("9 aliases"), "{error}");
        assert!(open("PK\x03\x04", "half").err().unwrap().to_string().contains("unpack it"));
        let missing = OcioSpace::open(Path::new("/nowhere/config.ocio"), "half").err().unwrap().to_string();
        assert!(missing.starts_with("/nowhere/config.ocio: cannot read"), "{missing}");
    }
}
