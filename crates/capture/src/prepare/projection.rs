//! Whether photographs are pinhole images or equirectangular panoramas.
//!
//! In: [`Photograph`]s by their headers and a [`ProjectionChoice`]. Out: [`SetProjection`], the
//! same for all, with a note on the evidence for panoramas. Files say that they are panoramas by
//! Google's Photo Sphere XMP or OpenEXR's `envmap`; without that, photographs that are all twice as
//! wide as high, and of which none states a focal length, are taken for panoramas. Degenerate:
//! panoramas that show a part of the sphere, and panoramas among other photographs, are errors.

use luxel_core::Remedy;
use luxel_core::photo::StatedPanorama;
use luxel_core::text::plural;

use super::{Photograph, PrepareError, PrepareNote};

/// The projection that the user asks for.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum ProjectionChoice {
    /// By files' headers and sizes.
    #[default]
    Auto,
    /// A lens with straight lines, but for distortion.
    Pinhole,
    /// Whole panoramas, twice as wide as high.
    Equirectangular,
}

/// The projection of a set's photographs.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum SetProjection {
    /// A lens with straight lines, but for distortion.
    #[default]
    Pinhole,
    /// Whole panoramas.
    Equirectangular,
}

impl SetProjection {
    /// Returns the name that users know.
    pub fn name(self) -> &'static str {
        match self {
            Self::Pinhole => "pinhole",
            Self::Equirectangular => "equirectangular",
        }
    }
}

/// Decides the projection, and notes the evidence for panoramas.
pub(super) fn choose_projection(
    photos: &[Photograph],
    choice: ProjectionChoice,
    notes: &mut Vec<PrepareNote>,
) -> Result<SetProjection, PrepareError> {
    let is_double = |photo: &Photograph| photo.info.size_px[0] == 2 * photo.info.size_px[1];
    let count = |test: &dyn Fn(&Photograph) -> bool| photos.iter().filter(|photo| test(photo)).count();
    let (all, doubles) = (photos.len(), count(&is_double));
    let stated = count(&|photo| photo.info.exif.panorama.is_some());
    let has_focal_length = photos.iter().any(|photo| photo.info.exif.focal_35mm.is_some());
    let is_panorama = match choice {
        ProjectionChoice::Pinhole => false,
        ProjectionChoice::Equirectangular => true,
        ProjectionChoice::Auto => stated > 0 || all > 0 && doubles == all && !has_focal_length,
    };
    if !is_panorama {
        return Ok(SetProjection::Pinhole);
    }
    let named = |test: &dyn Fn(&Photograph) -> bool| photos.iter().find(|photo| test(photo)).map(Photograph::file_name).unwrap_or_default();
    let remedy = || Remedy::advice("leave the others out").or(Remedy::set("projection", "pinhole"));
    if choice == ProjectionChoice::Auto && 0 < stated && stated < all {
        let other = named(&|photo| photo.info.exif.panorama.is_none());
        let message =
            format!("{stated} of {} say that they are panoramas, and {other} does not: a set has one projection", plural(all, "file"));
        let choices = Remedy::set("projection", "equirectangular").or(Remedy::set("projection", "pinhole"));
        return Err(PrepareError::new(message).with_remedy(choices));
    }
    let is_part = |photo: &Photograph| photo.info.exif.panorama == Some(StatedPanorama::Part);
    if count(&is_part) > 0 {
        let message = format!("{}: a panorama of a part of the sphere, expected whole ones", named(&is_part));
        return Err(PrepareError::new(message).with_remedy(Remedy::advice("fill it up to the whole sphere, with black")));
    }
    if doubles < all {
        let odd = |photo: &Photograph| !is_double(photo);
        let [width, height] = photos.iter().find(|photo| odd(photo)).map_or([0, 0], |photo| photo.info.size_px);
        let message = format!("{}: {width} x {height} pixels, expected a panorama twice as wide as high", named(&odd));
        return Err(PrepareError::new(message).with_remedy(remedy()));
    }
    let why = match (choice, stated) {
        (ProjectionChoice::Equirectangular, _) => None,
        (_, 0) => Some("taken as equirectangular panoramas, because all are twice as wide as high and none states a focal length"),
        _ => Some("taken as equirectangular panoramas, as the files say"),
    };
    notes.extend(why.map(|why| PrepareNote::new(why).with_remedy(Remedy::set("projection", "pinhole"))));
    Ok(SetProjection::Equirectangular)
}

#[cfg(test)]
mod tests {
    use luxel_core::photo::{Exif, PhotoInfo, PhotoKind};

    use super::*;

    fn photo(name: &str, size_px: [u32; 2], panorama: Option<StatedPanorama>) -> Photograph {
        let exif = Exif { panorama, ..Exif::default() };
        let info = PhotoInfo {
            kind: PhotoKind::Developed,
            size_px,
            exif,
            raw: None,
            profile: None,
            primaries: None,
            curve: None,
            has_gain_map: false,
        };
        Photograph { path: name.into(), stem: name.into(), digest: name.into(), info, exposure: None }
    }

    fn choose(photos: &[Photograph], choice: ProjectionChoice) -> Result<(SetProjection, Vec<PrepareNote>), String> {
        let mut notes = Vec::new();
        choose_projection(photos, choice, &mut notes).map(|found| (found, notes)).map_err(|error| error.message)
    }

    #[test]
    fn panoramas_are_told_by_their_files_or_their_shape() {
        let whole = Some(StatedPanorama::Whole);
        let (found, notes) = choose(&[photo("a", [64, 32], whole), photo("b", [64, 32], whole)], ProjectionChoice::Auto).unwrap();
        assert!(found == SetProjection::Equirectangular && notes[0].text.contains("as the files say"), "{notes:?}");
        let mut photos = [photo("a", [64, 32], None), photo("b", [128, 64], None)];
        let (found, notes) = choose(&photos, ProjectionChoice::Auto).unwrap();
        assert!(found == SetProjection::Equirectangular && notes[0].text.contains("twice as wide as high"), "{notes:?}");
        assert_eq!(choose(&photos, ProjectionChoice::Pinhole).unwrap(), (SetProjection::Pinhole, Vec::new()));
        assert_eq!(choose(&photos, ProjectionChoice::Equirectangular).unwrap(), (SetProjection::Equirectangular, Vec::new()));
        // A lens has a focal length, a stitched sphere has none.
        photos[0].info.exif.focal_35mm = Some(24.0);
        assert_eq!(choose(&photos, ProjectionChoice::Auto).unwrap().0, SetProjection::Pinhole);
        let mixed = [photo("a", [64, 32], None), photo("b", [64, 48], None)];
        assert_eq!(choose(&mixed, ProjectionChoice::Auto).unwrap().0, SetProjection::Pinhole);
    }

    #[test]
    fn panoramas_that_are_not_whole_or_not_alone_are_refused() {
        let error = |photos: &[Photograph], choice| choose(photos, choice).unwrap_err();
        let [whole, part] = [Some(StatedPanorama::Whole), Some(StatedPanorama::Part)];
        let mixed = [photo("a", [64, 32], whole), photo("b", [64, 48], None)];
        let found = error(&mixed, ProjectionChoice::Auto);
        assert!(found.starts_with("1 of 2 files say that they are panoramas, and b does not"), "{found}");
        let found = error(&mixed, ProjectionChoice::Equirectangular);
        assert!(found.starts_with("b: 64 x 48 pixels, expected a panorama twice as wide as high"), "{found}");
        let found = error(&[photo("a", [64, 20], part)], ProjectionChoice::Auto);
        assert!(found.starts_with("a: a panorama of a part of the sphere"), "{found}");
    }
}
