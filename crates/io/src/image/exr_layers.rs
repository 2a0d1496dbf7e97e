//! The picture to read among the parts, layers and views of an OpenEXR file.
//!
//! In: the headers of all parts, and the names that a user asks for. Out: the part and its channels
//! of red, green and blue, or of luminance where no part has colour.
//!
//! Without a choice: of several views the hero view, which is the first of `multiView` or the left
//! eye; then the only picture there is; then the one without a layer's name; then the one with a
//! name that beauty passes have ([`BEAUTY_NAMES`]). Whatever is passed over is named in a warning,
//! and where these rules find no single picture, all of them are named in an error.

use ::exr::meta::header::Header;
use luxel_core::Remedy;

use crate::IoError;
use crate::input::Input;

/// Names of beauty passes in the programs that write them: Nuke, Blender, Arnold, V-Ray, RenderMan,
/// Houdini. Compared without regard to case.
const BEAUTY_NAMES: [&str; 10] = ["rgba", "rgb", "beauty", "combined", "composite", "ci", "c", "main", "color", "final"];

/// Names of views that come first where a file does not order them.
const HERO_VIEWS: [&str; 4] = ["left", "l", "center", "main"];

/// Names of the view that is never read unsaid.
const RIGHT_VIEWS: [&str; 2] = ["right", "r"];

/// Pictures that a message lists.
const MAX_LISTED: usize = 24;

/// Indices of channels within a part.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct ColorChannels {
    /// Red, green, blue; the same one three times for luminance.
    pub(super) rgb: [usize; 3],
    pub(super) alpha: Option<usize>,
}

/// A picture of a file that was chosen.
#[derive(Debug)]
pub(super) struct Picture {
    /// Index of its part.
    pub(super) part: usize,
    pub(super) color: ColorChannels,
    /// Warnings about pictures that were passed over.
    pub(super) warnings: Vec<String>,
}

/// The channels that a picture may consist of, the better first.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Kind {
    Rgb,
    Luminance,
}

/// The names in a part's header that tell its pictures apart.
#[derive(Clone, Debug, Default)]
struct PartNames {
    name: Option<String>,
    /// The part's own view.
    view: Option<String>,
    /// Views whose names channels may carry, the hero first.
    views: Vec<String>,
    channels: Vec<String>,
}

impl PartNames {
    fn from_header(header: &Header) -> Self {
        let own = &header.own_attributes;
        Self {
            name: own.layer_name.as_ref().map(ToString::to_string).filter(|name| !name.is_empty()),
            view: own.view_name.as_ref().map(ToString::to_string).filter(|view| !view.is_empty()),
            views: own.multi_view_names.iter().flatten().map(ToString::to_string).collect(),
            channels: header.channels.list.iter().map(|channel| channel.name.to_string()).collect(),
        }
    }
}

/// A picture that a file holds.
#[derive(Clone, Debug, PartialEq)]
struct Candidate {
    part: usize,
    color: ColorChannels,
    /// Name of the part, without that of its view.
    part_name: Option<String>,
    /// Name of the layer within the part; empty for channels without one.
    layer: String,
    view: Option<String>,
}

impl Candidate {
    /// Returns the name for people, of which a user may give any part.
    fn label(&self) -> String {
        let layer = Some(self.layer.clone()).filter(|layer| !layer.is_empty());
        let names: Vec<String> = [self.part_name.clone(), layer, self.view.clone()].into_iter().flatten().collect();
        if names.is_empty() { "the one without a name".to_owned() } else { names.join("/") }
    }

    fn is_named(&self, name: &str) -> bool {
        let own = [self.part_name.as_deref(), Some(self.layer.as_str()), Some(last(&self.layer)), self.view.as_deref()];
        own.into_iter().flatten().any(|own| own.eq_ignore_ascii_case(name))
    }

    /// Returns whether the layer, or the part of a picture without one, is named like a beauty
    /// pass.
    fn is_beauty(&self) -> bool {
        let name = if self.layer.is_empty() { self.part_name.as_deref().unwrap_or_default() } else { self.layer.as_str() };
        is_one_of(last(name), &BEAUTY_NAMES)
    }
}

/// Returns the last part of a layer's name: `Combined` of `ViewLayer.Combined`.
fn last(layer: &str) -> &str {
    layer.rsplit('.').next().unwrap_or(layer)
}

fn is_one_of(name: &str, names: &[&str]) -> bool {
    names.iter().any(|one| one.eq_ignore_ascii_case(name))
}

/// Returns the picture to read. `wanted`: names of its part, layer or view, separated by slashes.
pub(super) fn find_picture(input: Input<'_>, headers: &[Header], wanted: Option<&str>) -> Result<Picture, IoError> {
    let parts: Vec<PartNames> = headers.iter().map(PartNames::from_header).collect();
    let unsupported = |message: String| input.unsupported(format!("OpenEXR: {message}"));
    choose(&parts, wanted).map_err(|refusal| {
        let error = unsupported(refusal.message);
        if refusal.helps_to_choose { error.with_remedy(Remedy::give("layer")) } else { error }
    })
}

/// Explains why no picture is read.
#[derive(Debug, PartialEq)]
struct Refusal {
    message: String,
    /// Whether naming a layer helps.
    helps_to_choose: bool,
}

fn choose(parts: &[PartNames], wanted: Option<&str>) -> Result<Picture, Refusal> {
    let all = [Kind::Rgb, Kind::Luminance].into_iter().map(|kind| candidates(parts, kind)).find(|found| !found.is_empty());
    let Some(all) = all else {
        let found: Vec<_> = parts.iter().flat_map(|part| part.channels.iter().cloned()).take(16).collect();
        if ["Y", "RY", "BY"].into_iter().all(|name| found.iter().any(|channel| last(channel) == name)) {
            let message = "no colour that is read: luminance and chroma (Y, RY, BY); export it as RGB".to_owned();
            return Err(Refusal { message, helps_to_choose: false });
        }
        let message = format!("no colour, found channels {}; expected R, G, B or Y; export it as RGB", found.join(", "));
        return Err(Refusal { message, helps_to_choose: false });
    };
    let is_asked = |c: &&Candidate| wanted.is_none_or(|text| c.is_named(text) || text.split('/').all(|name| c.is_named(name.trim())));
    let asked: Vec<Candidate> = all.iter().filter(is_asked).cloned().collect();
    if asked.is_empty() {
        let message = format!("no part, layer or view {:?}, found {}", wanted.unwrap_or_default(), listed(&all));
        return Err(Refusal { message, helps_to_choose: true });
    }
    let mut warnings = Vec::new();
    let of_view = of_hero_view(asked, parts, &mut warnings);
    let chosen = match of_view.as_slice() {
        [only] => only.clone(),
        several => match beauty(several) {
            Some(chosen) => chosen.clone(),
            None => {
                let message = format!("several parts or layers have colour ({}), expected one that is the beauty pass", listed(several));
                return Err(Refusal { message, helps_to_choose: true });
            }
        },
    };
    let others: Vec<Candidate> = of_view.iter().filter(|c| **c != chosen).cloned().collect();
    // Passes beside the channels R, G, B of one part are what the format's rules make them.
    if !(others.is_empty() || chosen.layer.is_empty() && others.iter().all(|other| other.part == chosen.part)) {
        warnings.push(format!("of several parts or layers {} is read, not {}", chosen.label(), listed(&others)));
    }
    Ok(Picture { part: chosen.part, color: chosen.color, warnings })
}

/// Returns the names of pictures; a long list is cut.
fn listed(candidates: &[Candidate]) -> String {
    let names: Vec<String> = candidates.iter().take(MAX_LISTED).map(Candidate::label).collect();
    let more = candidates.len().saturating_sub(MAX_LISTED);
    let rest = if more > 0 { format!(" and {more} more") } else { String::new() };
    format!("{}{rest}", names.join(", "))
}

/// Returns the only picture without a layer, else the only one that is named like a beauty pass.
fn beauty(several: &[Candidate]) -> Option<&Candidate> {
    fn only<'a>(found: &[&'a Candidate]) -> Option<&'a Candidate> {
        if let [one] = found { Some(one) } else { None }
    }
    let without_layer = only(&several.iter().filter(|c| c.layer.is_empty()).collect::<Vec<_>>());
    let is_one_part = several.iter().all(|c| c.part == several[0].part);
    match without_layer {
        Some(one) if is_one_part || one.is_beauty() => Some(one),
        _ => only(&several.iter().filter(|c| c.is_beauty()).collect::<Vec<_>>()).or(without_layer),
    }
}

/// Keeps the pictures of the hero view, where there are several views.
fn of_hero_view(asked: Vec<Candidate>, parts: &[PartNames], warnings: &mut Vec<String>) -> Vec<Candidate> {
    let mut views: Vec<&str> = Vec::new();
    let ordered = parts.iter().flat_map(|part| &part.views).map(String::as_str);
    for view in ordered.chain(asked.iter().filter_map(|c| c.view.as_deref())) {
        if !views.contains(&view) && asked.iter().any(|c| c.view.as_deref() == Some(view)) {
            views.push(view);
        }
    }
    let is_ordered = parts.iter().any(|part| !part.views.is_empty());
    let named = views.iter().find(|view| !is_ordered && is_one_of(view, &HERO_VIEWS));
    let Some(&hero) = named.or(views.first()) else { return asked };
    if views.len() > 1 {
        warnings.push(format!("the view {hero} is read, of {}", views.join(", ")));
    } else if is_one_of(hero, &RIGHT_VIEWS) {
        warnings.push(format!("the view is {hero}, of a stereo pair"));
    }
    let hero = hero.to_owned();
    asked.into_iter().filter(|c| c.view.as_deref().is_none_or(|view| view == hero)).collect()
}

/// Returns the pictures of all parts.
fn candidates(parts: &[PartNames], kind: Kind) -> Vec<Candidate> {
    let mut found: Vec<Candidate> = Vec::new();
    for (index, part) in parts.iter().enumerate() {
        let mut layers: Vec<&str> =
            part.channels.iter().map(|name| name.rfind('.').and_then(|dot| name.get(..dot)).unwrap_or_default()).collect();
        // Sorted, so that the channels without a layer come first.
        layers.sort_unstable();
        layers.dedup();
        for layer in layers {
            let Some(color) = color_of(&part.channels, layer, kind) else { continue };
            let (layer, of_channels) = without_view(layer, |view| part.is_view(view));
            let view = of_channels.map(str::to_owned).or_else(|| part.view.clone()).or_else(|| part.views.first().cloned());
            let part_name = part.name.as_deref().filter(|_| parts.len() > 1);
            let (part_name, of_part) = match part_name {
                Some(name) => {
                    let is_view = |view: &str| part.is_view(view) || (part.view.is_none() && is_stereo(view, parts));
                    let (name, view) = without_view(name, is_view);
                    (Some(name.to_owned()).filter(|name| !name.is_empty()), view)
                }
                None => (None, None),
            };
            let view = view.or_else(|| of_part.map(str::to_owned));
            found.push(Candidate { part: index, color, part_name, layer: layer.to_owned(), view });
        }
    }
    found
}

impl PartNames {
    /// Returns whether a part of a channel's name is that of a view.
    fn is_view(&self, name: &str) -> bool {
        let is_known = self.view.as_deref() == Some(name) || self.views.iter().any(|view| view == name);
        // Without attributes a pair tells itself.
        let has = |other: &str| self.channels.iter().any(|channel| channel.split('.').any(|word| word.eq_ignore_ascii_case(other)));
        is_known || (self.views.is_empty() && is_eye(name) && ["left", "right"].into_iter().all(has))
    }
}

fn is_eye(name: &str) -> bool {
    is_one_of(name, &["left", "right"])
}

/// Returns whether the names of the parts have both eyes.
fn is_stereo(name: &str, parts: &[PartNames]) -> bool {
    let has = |eye: &str| parts.iter().filter_map(|part| part.name.as_deref()).any(|name| last(name).eq_ignore_ascii_case(eye));
    is_eye(name) && has("left") && has("right")
}

/// Splits a name into what stands before the view's and the view: `Combined` and `left` of
/// `Combined.left`.
fn without_view(name: &str, is_view: impl Fn(&str) -> bool) -> (&str, Option<&str>) {
    let end = last(name);
    if !is_view(end) {
        return (name, None);
    }
    (name.strip_suffix(end).unwrap_or_default().trim_end_matches('.'), Some(end))
}

/// Returns the channels of a layer's colour.
fn color_of(channels: &[String], layer: &str, kind: Kind) -> Option<ColorChannels> {
    let exact = |channel: &str| {
        let full = if layer.is_empty() { channel.to_owned() } else { format!("{layer}.{channel}") };
        channels.iter().position(|name| *name == full)
    };
    let index_of = |spellings: &[&str]| spellings.iter().find_map(|channel| exact(channel));
    let rgb = match kind {
        Kind::Rgb => [index_of(&["R", "r", "red"])?, index_of(&["G", "g", "green"])?, index_of(&["B", "b", "blue"])?],
        // Beside RY and BY it is the luminance of a colour image, beside X or Z a number of a
        // vector: a grey picture would be wrong.
        Kind::Luminance if ["RY", "BY", "X", "Z"].iter().any(|other| exact(other).is_some()) => return None,
        Kind::Luminance => [exact("Y")?; 3],
    };
    Some(ColorChannels { rgb, alpha: index_of(&["A", "a", "alpha"]) })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn part(name: &str, view: &str, channels: &[&str]) -> PartNames {
        let given = |text: &str| Some(text.to_owned()).filter(|text| !text.is_empty());
        let channels = channels.iter().map(|channel| (*channel).to_owned()).collect();
        PartNames { name: given(name), view: given(view), views: Vec::new(), channels }
    }

    /// Returns the part and the red channel that are read, and the warnings.
    fn chosen(parts: &[PartNames], wanted: Option<&str>) -> (usize, String, Vec<String>) {
        let Picture { part, color, warnings } = choose(parts, wanted).unwrap();
        (part, parts[part].channels[color.rgb[0]].clone(), warnings)
    }

    const RGB: [&str; 3] = ["B", "G", "R"];

    #[test]
    fn vectors_are_no_grey_pictures() {
        for channels in [&["X", "Y", "Z"][..], &["motion.X", "motion.Y"], &["N.X", "N.Y", "N.Z"], &["BY", "RY", "Y"]] {
            let refusal = choose(&[part("", "", channels)], None).unwrap_err();
            assert!(refusal.message.contains("no colour") && !refusal.helps_to_choose, "{refusal:?}");
        }
        assert_eq!(chosen(&[part("", "", &["A", "Y"])], None), (0, "Y".to_owned(), vec![]));
    }

    #[test]
    fn the_beauty_pass_is_read_and_what_is_passed_over_is_named() {
        let parts = [part("albedo", "", &RGB), part("rgba", "", &RGB), part("depth", "", &["Z"])];
        assert_eq!(chosen(&parts, None), (1, "R".to_owned(), vec!["of several parts or layers rgba is read, not albedo".to_owned()]));
        assert_eq!(chosen(&parts, Some("albedo")), (0, "R".to_owned(), vec![]));
        // Nuke: the parts' channels carry their layer.
        let nuke = [part("rgba", "", &RGB), part("diffuse", "", &["diffuse.blue", "diffuse.green", "diffuse.red"])];
        assert_eq!(chosen(&nuke, None).0, 0);
        assert_eq!(chosen(&nuke, Some("diffuse")), (1, "diffuse.red".to_owned(), vec![]));
        // A part without a layer in its channels and with no telling name, beside parts with one.
        let other = [part("Layer 1", "", &RGB), part("diffuse", "", &["diffuse.B", "diffuse.G", "diffuse.R"])];
        assert_eq!(chosen(&other, None).0, 0);
        // Passes beside R, G, B of the same part are not the picture.
        let passes = [part("", "", &["B", "G", "R", "albedo.B", "albedo.G", "albedo.R"])];
        assert_eq!(chosen(&passes, None), (0, "R".to_owned(), vec![]));
        assert_eq!(chosen(&passes, Some("albedo")).1, "albedo.R");
    }

    #[test]
    fn blenders_combined_pass_is_read() {
        let channels = ["V.Combined.A", "V.Combined.B", "V.Combined.G", "V.Combined.R", "V.DiffCol.B", "V.DiffCol.G", "V.DiffCol.R"];
        let (_, red, warnings) = chosen(&[part("", "", &channels)], None);
        assert_eq!(
            (red.as_str(), warnings),
            ("V.Combined.R", vec!["of several parts or layers V.Combined is read, not V.DiffCol".to_owned()])
        );
        assert_eq!(chosen(&[part("", "", &channels)], Some("DiffCol")).1, "V.DiffCol.R");
        assert_eq!(chosen(&[part("", "", &channels)], Some("v.combined")).1, "V.Combined.R");
        let one = ["V.Combined.B", "V.Combined.G", "V.Combined.R", "V.Normal.X", "V.Normal.Y", "V.Normal.Z"];
        assert_eq!(chosen(&[part("", "", &one)], None), (0, "V.Combined.R".to_owned(), vec![]));
        // Two scenes' worth of passes: nobody but the user knows.
        let two = ["Fg.Combined.B", "Fg.Combined.G", "Fg.Combined.R", "Bg.Combined.B", "Bg.Combined.G", "Bg.Combined.R"];
        let refusal = choose(&[part("", "", &two)], None).unwrap_err();
        assert!(refusal.helps_to_choose && refusal.message.contains("Bg.Combined, Fg.Combined"), "{refusal:?}");
        assert_eq!(chosen(&[part("", "", &two)], Some("Fg.Combined")).1, "Fg.Combined.R");
    }

    #[test]
    fn parts_without_telling_names_are_refused_by_name() {
        let refusal = choose(&[part("one", "", &RGB), part("two", "", &RGB)], None).unwrap_err();
        assert_eq!(refusal.message, "several parts or layers have colour (one, two), expected one that is the beauty pass");
        let missing = choose(&[part("one", "", &RGB), part("two", "", &RGB)], Some("three")).unwrap_err();
        assert_eq!(missing.message, "no part, layer or view \"three\", found one, two");
        assert!(missing.helps_to_choose);
    }

    #[test]
    fn the_right_eye_is_never_read_unsaid() {
        let said = vec!["the view left is read, of right, left".to_owned()];
        let parts = [part("rgba.right", "right", &RGB), part("rgba.left", "left", &RGB)];
        assert_eq!(chosen(&parts, None), (1, "R".to_owned(), said.clone()));
        assert_eq!(chosen(&parts, Some("right")), (0, "R".to_owned(), vec!["the view is right, of a stereo pair".to_owned()]));
        // Without the attribute the parts' names tell.
        let named = [part("rgba.right", "", &RGB), part("rgba.left", "", &RGB)];
        assert_eq!(chosen(&named, None), (1, "R".to_owned(), said));
        // Views within one part: the channels without a name are the first view's.
        let mut one = part("", "", &["B", "G", "R", "left.B", "left.G", "left.R"]);
        one.views = vec!["right".to_owned(), "left".to_owned()];
        assert_eq!(chosen(&[one.clone()], None), (0, "R".to_owned(), vec!["the view right is read, of right, left".to_owned()]));
        assert_eq!(chosen(&[one], Some("left")), (0, "left.R".to_owned(), vec![]));
        // Blender's stereo file, without and with layers chosen.
        let channels = [
            "V.Combined.left.B",
            "V.Combined.left.G",
            "V.Combined.left.R",
            "V.Combined.right.B",
            "V.Combined.right.G",
            "V.Combined.right.R",
        ];
        assert_eq!(chosen(&[part("", "", &channels)], None).1, "V.Combined.left.R");
        assert_eq!(chosen(&[part("", "", &channels)], Some("Combined/right")).1, "V.Combined.right.R");
        let single = part("", "right", &RGB);
        assert_eq!(chosen(&[single], None).2, ["the view is right, of a stereo pair"]);
    }
}
