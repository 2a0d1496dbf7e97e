//! Methods by name: the rows of the tables.
//!
//! In: `nerf-grid`, `hdr-nerf-grid` and `mono-hdr-nerf-grid`, radiance fields, with `-linear`
//! behind the first for the loss of linear radiance, and sizes in place of `grid` for a network
//! without a grid, `nerf-8x256`; `hdr-gs` and `mono-hdr-gs`, which train on captured images beside
//! radiance, `gausshdr` on those alone; `lcd-anchors` and
//! `gausshdr-anchors`, whose splats anchors decode; `sh0` to `sh5`; `logsh3`; `lcd` with parts
//! behind it in any order: `-exp` or `-relu` for the activation (softplus without), `-lN` for the
//! degree to which luminance varies with the view (0 without), `-cN` for the degree of chromaticity
//! (3 without). Out: the method, which has one name ([`StudyMethod::name`]), and options of
//! training. A name determines the whole method: `lcd` is the paper's whatever the defaults of
//! training are.

use luxel_core::{Activation, ColorModel};
use luxel_train::{
    Colors, FieldLoss, FieldNetworkChoice, HdrNormalisation, Method, MethodSpec, NamedChoice, Representation, Scheme, TrainConfig,
};

/// Names of the training options that a method's name stands for.
pub const METHOD_OPTIONS: [&str; 6] = ["method", "activation", "chroma_degree", "luminance_degree", "field_loss", "field_network"];

/// Degree of chromaticity that the paper has.
const CHROMA_DEGREE: u8 = 3;

/// A method of a study: splats of a colour model, or a method without splats.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum StudyMethod {
    /// Splats of this colour model.
    Splats(ColorModel),
    /// Splats that are trained by steps of their method's own, on captured images, or that anchors
    /// decode.
    OwnSteps(Method),
    /// A radiance field.
    Field {
        /// The method.
        method: Method,
        /// The loss, where the method has a choice.
        loss: Option<FieldLoss>,
        /// Layers and units of a network without a hash grid.
        network: Option<FieldNetworkChoice>,
    },
}

impl StudyMethod {
    /// Returns the name, which [`parse_method`] reads.
    pub fn name(self) -> String {
        match self {
            Self::Splats(model) => model.name(),
            Self::OwnSteps(method) => method.name().to_owned(),
            Self::Field { method, loss, network } => {
                let name = match network {
                    None => method.name().to_owned(),
                    Some(network) => method.name().replace("-grid", &format!("-{network}")),
                };
                loss.map_or(name.clone(), |loss| format!("{name}-{}", loss.name()))
            }
        }
    }

    /// Returns the colour model of stored splats.
    pub fn color_model(self) -> Option<ColorModel> {
        match self {
            Self::Splats(model) => Some(model),
            Self::OwnSteps(method) if method.stores_splats() => Some(TrainConfig { method, ..TrainConfig::default() }.color_model()),
            Self::OwnSteps(_) | Self::Field { .. } => None,
        }
    }
}

/// Reads the method that a name stands for.
///
/// ```
/// use luxel_app::study::parse_method;
///
/// assert_eq!(parse_method("sh3")?.name(), "sh3");
/// let model = parse_method("lcd-c2-l1")?.color_model().ok_or("no splats")?;
/// assert_eq!(model.parameters(), 1 + 3 + 3 * 8 + 3);
/// assert_eq!(parse_method("nerf-grid")?.color_model(), None);
/// assert!(parse_method("nerf").is_err());
/// # Ok::<(), String>(())
/// ```
///
/// # Errors
/// Text for people: the unknown name, and the expected ones.
pub fn parse_method(text: &str) -> Result<StudyMethod, String> {
    if let Some(field) = field(text) {
        return Ok(field);
    }
    let model = match Method::from_name(text).map(|method| (method, method.spec())) {
        Some((method, spec)) if has_own_steps(spec) => return Ok(StudyMethod::OwnSteps(method)),
        Some((_, MethodSpec { colors: Colors::Fixed(model), .. })) => Some(*model),
        _ => lcd(text),
    };
    model.filter(|model| model.is_valid()).map(StudyMethod::Splats).ok_or_else(|| {
        let own = Method::VALUES.iter().filter(|(method, _)| has_own_steps(method.spec()));
        let own: String = own.map(|(_, value)| format!("{}, ", value.name)).collect();
        format!(
            "unknown method \"{text}\", expected table1, table2, nerf-grid, nerf-grid-linear, hdr-nerf-grid, mono-hdr-nerf-grid, nerf-8x256, {own}sh0 to sh5, logsh3, or lcd with -exp or -relu, -l0 to -l3, -c0 to -c5 after it: lcd-exp, lcd-c2-l1"
        )
    })
}

/// Returns whether a method's splats are decoded by anchors, or trained by steps of its own.
fn has_own_steps(method: &MethodSpec) -> bool {
    match method.representation {
        Representation::Splats => method.scheme.has_networks(),
        Representation::Anchors => true,
        Representation::Field => false,
    }
}

/// Returns the method whose splats the engine's steps train in these colours.
fn method_of(colors: Colors) -> Option<Method> {
    Method::find(|method| method.representation == Representation::Splats && !has_own_steps(method) && method.colors == colors)
}

fn field(text: &str) -> Option<StudyMethod> {
    let (name, loss) = match text.strip_suffix("-linear") {
        Some(name) => (name, Some(FieldLoss::Linear)),
        None => (text, None),
    };
    let of_name = |name: &str| Method::from_name(name).filter(|method| method.spec().representation == Representation::Field);
    let without_grid = || {
        let (stem, sizes) = name.rsplit_once('-')?;
        let network @ FieldNetworkChoice::Layers { .. } = sizes.parse().ok()? else { return None };
        Some((of_name(&format!("{stem}-grid"))?, Some(network)))
    };
    let (method, network) = of_name(name).map(|method| (method, None)).or_else(without_grid)?;
    let found = StudyMethod::Field { method, loss, network };
    // A name has one form.
    ((loss.is_none() || method.spec().scheme == Scheme::Radiance) && found.name() == text).then_some(found)
}

fn lcd(text: &str) -> Option<ColorModel> {
    let mut parts = text.split('-');
    if parts.next() != Some("lcd") {
        return None;
    }
    let (mut activation, mut luminance_degree, mut chroma_degree) = (None, None, None);
    for part in parts {
        // Each part may occur once: names of one model differ in the order of parts only.
        let is_new = match part.split_at_checked(1) {
            Some(("l", degree)) => luminance_degree.replace(degree.parse::<u8>().ok()?).is_none(),
            Some(("c", degree)) => chroma_degree.replace(degree.parse::<u8>().ok()?).is_none(),
            _ if part == "exp" => activation.replace(Activation::Exp).is_none(),
            _ if part == "relu" => activation.replace(Activation::Relu).is_none(),
            _ => false,
        };
        if !is_new {
            return None;
        }
    }
    Some(ColorModel::Lcd {
        chroma_degree: chroma_degree.unwrap_or(CHROMA_DEGREE),
        luminance_degree: luminance_degree.unwrap_or(0),
        activation: activation.unwrap_or(Activation::Softplus),
    })
}

/// Returns the options with a method.
pub(super) fn with_method(options: &TrainConfig, method: StudyMethod) -> TrainConfig {
    let model = match method {
        StudyMethod::Splats(model) => model,
        StudyMethod::OwnSteps(method) => {
            let (activation, chroma_degree, luminance_degree, field_loss) = (None, None, None, None);
            let options = TrainConfig { field_network: None, ..options.clone() };
            return TrainConfig { method, activation, chroma_degree, luminance_degree, field_loss, ..options };
        }
        StudyMethod::Field { method, loss, network } => {
            return TrainConfig {
                method,
                activation: None,
                chroma_degree: None,
                luminance_degree: None,
                field_loss: loss,
                field_network: network,
                ..options.clone()
            };
        }
    };
    let (colors, activation, chroma_degree, luminance_degree) = match model {
        ColorModel::Lcd { chroma_degree, luminance_degree, activation } => {
            (Colors::Lcd, Some(activation), Some(chroma_degree), Some(luminance_degree))
        }
        model => (Colors::Fixed(model), None, None, None),
    };
    // A mix is made of scenes, not trained.
    let Some(method) = method_of(colors) else { return options.clone() };
    TrainConfig { method, activation, chroma_degree, luminance_degree, field_loss: None, field_network: None, ..options.clone() }
}

/// Returns a description in a few words. `scale` is that of the runs' radiance under the mu-law,
/// which names the two forms of HDR-GS and Mono-HDR-GS.
pub(super) fn description(method: StudyMethod, scale: HdrNormalisation) -> String {
    let model = match method {
        StudyMethod::Splats(model) => model,
        StudyMethod::OwnSteps(method) => {
            let MethodSpec { title, scheme, .. } = method.spec();
            return if *scheme == Scheme::Pairs { format!("{title}, {} scale", scale.name()) } else { (*title).to_owned() };
        }
        StudyMethod::Field { method, loss, network } => {
            let name = method.spec().title;
            let network = network.map_or("hash grid".to_owned(), |network| format!("{network} network, no hash grid"));
            let loss = if loss == Some(FieldLoss::Linear) { ", loss of radiance" } else { "" };
            return format!("{name}, {network}{loss}");
        }
    };
    let ColorModel::Lcd { chroma_degree, luminance_degree, activation } = model else {
        return method_of(Colors::Fixed(model)).map_or_else(|| model.name(), |method| method.spec().title.to_owned());
    };
    let mut words = match activation {
        Activation::Softplus => "LCD".to_owned(),
        Activation::Exp => "LCD, exponential".into(),
        Activation::Relu => "LCD, ReLU".into(),
    };
    if luminance_degree > 0 {
        words += &format!(", luminance of degree {luminance_degree}");
    }
    if chroma_degree != CHROMA_DEGREE {
        words += &format!(", chromaticity of degree {chroma_degree}");
    }
    words
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_say_the_whole_colour_model() {
        let lcd = |chroma_degree, luminance_degree, activation| ColorModel::Lcd { chroma_degree, luminance_degree, activation };
        for (name, expected) in [
            ("sh0", ColorModel::Sh { degree: 0 }),
            ("sh5", ColorModel::Sh { degree: 5 }),
            ("logsh3", ColorModel::LogSh { degree: 3 }),
            ("lcd", lcd(3, 0, Activation::Softplus)),
            ("lcd-exp", lcd(3, 0, Activation::Exp)),
            ("lcd-relu-l2", lcd(3, 2, Activation::Relu)),
            ("lcd-l3-c1", lcd(1, 3, Activation::Softplus)),
        ] {
            let expected_method = StudyMethod::Splats(expected);
            let model = parse_method(name).unwrap();
            assert_eq!((model, parse_method(&model.name())), (expected_method, Ok(expected_method)), "{name}");
            let config = with_method(&TrainConfig { luminance_degree: Some(1), ..TrainConfig::default() }, model);
            assert_eq!(config.color_model(), expected, "{name}");
            config.validate().unwrap();
        }
    }

    #[test]
    fn methods_with_steps_of_their_own_are_methods_too() {
        for (name, expected) in [
            ("hdr-gs", Method::HdrGs),
            ("mono-hdr-gs", Method::MonoHdrGs),
            ("gausshdr", Method::GaussHdr),
            ("lcd-anchors", Method::LcdAnchors),
            ("gausshdr-anchors", Method::GaussHdrAnchors),
        ] {
            let method = parse_method(name).unwrap();
            assert_eq!((method, method.name().as_str()), (StudyMethod::OwnSteps(expected), name));
            let words = [HdrNormalisation::Scene, HdrNormalisation::Own].map(|scale| description(method, scale));
            match expected {
                Method::HdrGs => assert_eq!(words, ["HDR-GS, scene scale", "HDR-GS, self scale"]),
                Method::MonoHdrGs => assert_eq!(words, ["Mono-HDR-GS, scene scale", "Mono-HDR-GS, self scale"]),
                _ => assert_eq!(words[0], words[1]),
            }
            let config = with_method(&TrainConfig { luminance_degree: Some(1), ..TrainConfig::default() }, method);
            assert_eq!((config.method, config.luminance_degree), (expected, None));
            config.validate().unwrap();
        }
    }

    #[test]
    fn fields_are_methods_too() {
        let (linear, network) = (Some(FieldLoss::Linear), Some(FieldNetworkChoice::Layers { layers: 8, units: 256 }));
        for (name, method, loss, network, words) in [
            ("nerf-grid", Method::NerfGrid, None, None, "NeRF, hash grid"),
            ("nerf-grid-linear", Method::NerfGrid, linear, None, "NeRF, hash grid, loss of radiance"),
            ("nerf-8x256", Method::NerfGrid, None, network, "NeRF, 8x256 network, no hash grid"),
            ("nerf-8x256-linear", Method::NerfGrid, linear, network, "NeRF, 8x256 network, no hash grid, loss of radiance"),
            ("hdr-nerf-grid", Method::HdrNerfGrid, None, None, "HDR-NeRF, hash grid"),
            ("mono-hdr-nerf-grid", Method::MonoHdrNerfGrid, None, None, "Mono-HDR-NeRF, hash grid"),
            ("mono-hdr-nerf-8x256", Method::MonoHdrNerfGrid, None, network, "Mono-HDR-NeRF, 8x256 network, no hash grid"),
        ] {
            let found = parse_method(name).unwrap();
            assert_eq!((found, found.name().as_str()), (StudyMethod::Field { method, loss, network }, name));
            assert_eq!(description(found, HdrNormalisation::Scene), words);
            let config = with_method(&TrainConfig { luminance_degree: Some(1), ..TrainConfig::default() }, found);
            assert_eq!((config.method, config.field_loss, config.field_network), (method, loss, network));
            config.validate().unwrap();
        }
        for name in ["hdr-nerf-grid-linear", "nerf-gridx256", "nerf-grid-8x256", "hdr-gs-8x256", "nerf-08x256"] {
            assert!(parse_method(name).is_err(), "{name}");
        }
        assert!(parse_method("lcd-linear").is_err() && parse_method("nerf-grid-mulaw").is_err());
    }

    #[test]
    fn other_names_are_refused_with_the_expected_ones() {
        for name in [
            "",
            "sh",
            "sh6",
            "sh-1",
            "sh+1",
            "sh33",
            "lcd-",
            "lcdexp",
            "lcd-l4",
            "lcd-c6",
            "lcd-exp-exp",
            "lcd-exp-relu",
            "lcd-l",
            "lcd-ä",
            "nerf",
        ] {
            let error = parse_method(name).unwrap_err();
            assert!(error.contains(name) && error.contains("lcd-c2-l1"), "{error}");
        }
    }
}
