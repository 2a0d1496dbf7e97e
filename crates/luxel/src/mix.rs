//! Mixes of light: scenes of the same geometry and opacity under different light, added.
//!
//! In: scenes with weights. Out: one scene that holds every light with its gain
//! ([`luxel_core::Mix`]), in the radiance scale of the first. A render of it is the weighted sum of
//! the renders of the scenes, to rounding, for every colour model and every cut-off. Degenerate:
//! scenes whose geometry, opacity, order of splats, rasteriser, colour space or coordinates differ
//! are an error that names the first difference.

use luxel_core::{ColorModel, MAX_LIGHTS, Mix, Scene, Splats, text};

use crate::error::bail;
use crate::{Error, Remedy, Result};

/// A scene to mix.
#[derive(Clone, Debug)]
pub struct MixInput {
    /// Its name, for errors and the record in the mix.
    pub name: String,
    /// The scene.
    pub scene: Scene,
    /// Weight of its light, 0 or more.
    pub weight: f32,
}

/// Adds scenes of the same geometry under different light; a mix among them contributes all of its
/// lights.
///
/// ```
/// use luxel::mix::{MixInput, mix};
/// use luxel::synthetic;
///
/// # fn main() -> luxel::Result<()> {
/// let day = synthetic::room(100, 1).into_core();
/// let mut lamp = day.clone();
/// lamp.splats.raw_luminance.iter_mut().for_each(|l| *l -= 1.0);
/// let input = |name: &str, scene, weight| MixInput { name: name.to_owned(), scene, weight };
/// let both = mix(vec![input("day.ply", day, 1.0), input("lamp.ply", lamp, 0.3)])?;
/// assert_eq!(both.splats.color_model.lights(), 2);
/// assert_eq!(both.edits, ["mix \"day.ply\":1 \"lamp.ply\":0.3"]);
/// # Ok(())
/// # }
/// ```
///
/// # Errors
/// No scene, more than [`MAX_LIGHTS`] lights, a weight that is negative or not finite, colours of a
/// display, or scenes that do not go together.
pub fn mix(inputs: Vec<MixInput>) -> Result<Scene> {
    for MixInput { name, scene, weight } in &inputs {
        if !(weight.is_finite() && *weight >= 0.0) {
            bail!("{name}: weight {weight}, expected a finite number, 0 or more: light adds, and none is negative");
        }
        if !scene.color_space.is_linear() {
            let message = format!("{name}: its colours are a display's ({}), expected light: only light adds", scene.color_space.name());
            return Err(Error::new(message).with_remedy(Remedy::advice("mix the scenes that luxel trained, and export the mix")));
        }
        scene.splats.validate().map_err(|error| Error::new(format!("{name}: {error}")))?;
    }
    let Some(first) = inputs.first() else { bail!("no scene to mix") };
    for other in &inputs[1..] {
        if let Some(difference) = difference([first, other]) {
            let message = format!("{} and {} cannot be mixed: {difference}", first.name, other.name);
            let remedy =
                Remedy::advice("light adds on equal geometry: train the other light with --from the first scene and --freeze geometry");
            return Err(Error::new(message).with_remedy(remedy));
        }
    }
    let lights: usize = inputs.iter().map(|input| input.scene.splats.color_model.lights()).sum();
    let Some(model) = Mix::new(inputs.iter().map(|input| input.scene.splats.color_model)) else {
        bail!("{}, expected at most {MAX_LIGHTS}", text::plural(lights, "light"));
    };
    let mut scene = Scene { edits: record(&inputs), splats: mixed(&inputs, ColorModel::Mix(model)), ..first.scene.clone() };
    if let Some(metres) = inputs.iter().find_map(|input| input.scene.metres_per_unit) {
        scene.metres_per_unit = Some(metres);
    }
    scene.splats.validate().map_err(|error| Error::new(format!("the mix: {error}; lower the weights")))?;
    Ok(scene)
}

/// Returns the splats of the first scene with the coefficients of all.
fn mixed(inputs: &[MixInput], color_model: ColorModel) -> Splats {
    let splats = &inputs[0].scene.splats;
    let (k, m) = (3 * color_model.sh_coefficients(), color_model.luminance_coefficients());
    let (mut sh, mut raw_luminance) = (Vec::with_capacity(k * splats.len()), Vec::with_capacity(m * splats.len()));
    let scale = f64::from(inputs[0].scene.radiance_scale.get());
    for i in 0..splats.len() {
        for MixInput { scene, weight, .. } in inputs {
            // Radiance of the scene in normalised units of the mix.
            let factor = f64::from(*weight) * f64::from(scene.radiance_scale.get()) / scale * f64::from(scene.splats.gain_of(i));
            let (of_sh, of_raw) = (scene.splats.sh_of(i), scene.splats.raw_luminance_of(i));
            sh.extend_from_slice(of_sh);
            for component in scene.splats.color_model.components() {
                raw_luminance.push((factor * f64::from(component.gain(|at| of_raw[at]).unwrap_or(1.0))) as f32);
                raw_luminance.extend_from_slice(&of_raw[component.luminance..][..component.light.luminance_coefficients()]);
            }
        }
    }
    Splats { color_model, sh, raw_luminance, gain: Vec::new(), ..splats.clone() }
}

/// Returns the record of a mix: the edits of its scenes, and their names with the weights.
fn record(inputs: &[MixInput]) -> Vec<String> {
    // A name is one line of text.
    let name = |name: &str| name.chars().map(|c| if c.is_control() { ' ' } else { c }).collect::<String>();
    let parts: Vec<String> = inputs.iter().map(|input| format!("\"{}\":{}", name(&input.name), input.weight)).collect();
    let edits = inputs.iter().flat_map(|input| input.scene.edits.iter().map(|edit| format!("\"{}\": {edit}", name(&input.name))));
    edits.chain([format!("mix {}", parts.join(" "))]).collect()
}

/// Returns the first difference between scenes that mixing does not allow.
fn difference([a, b]: [&MixInput; 2]) -> Option<String> {
    let [first, other] = [&a.scene, &b.scene];
    if first.splats.len() != other.splats.len() {
        return Some(format!("{} and {}", text::plural(first.splats.len(), "splat"), text::plural(other.splats.len(), "splat")));
    }
    if let Some(difference) = splat_difference(&first.splats, &other.splats) {
        return Some(difference);
    }
    if first.raster != other.raster {
        return Some(format!("their rasterisers differ: {:?} and {:?}", first.raster, other.raster));
    }
    if first.color_space != other.color_space {
        return Some(format!("their colour spaces differ: {} and {}", first.color_space.name(), other.color_space.name()));
    }
    if first.world_from_local != other.world_from_local {
        return Some("their local coordinates differ".to_owned());
    }
    match (first.metres_per_unit, other.metres_per_unit) {
        (Some(one), Some(another)) if one != another => Some(format!("a unit is {one} m in one and {another} m in the other")),
        _ => None,
    }
}

/// Returns the first difference in geometry or opacity, to the bit.
fn splat_difference(first: &Splats, other: &Splats) -> Option<String> {
    if first.smoothing.len() != other.smoothing.len() {
        return Some("one has the 3D filter of Mip-splatting, the other has none".to_owned());
    }
    let bits = |values: &[f32]| values.iter().map(|v| v.to_bits()).collect::<Vec<_>>();
    let differs = |a: &[f32], b: &[f32]| bits(a) != bits(b);
    for i in 0..first.len() {
        let rows: [(&str, &[f32], &[f32]); 4] = [
            ("position", &first.position[i], &other.position[i]),
            ("rotation", &first.rotation[i], &other.rotation[i]),
            ("log scale", &first.log_scale[i], &other.log_scale[i]),
            ("opacity logit", &first.opacity_logit[i..=i], &other.opacity_logit[i..=i]),
        ];
        let smoothing = first.smoothing.get(i..=i).zip(other.smoothing.get(i..=i)).map(|(a, b)| ("3D filter", a, b));
        if let Some((what, a, b)) = rows.into_iter().chain(smoothing).find(|(_, a, b)| differs(a, b)) {
            return Some(format!("the {what} of splat {i} is {a:?} in one and {b:?} in the other"));
        }
    }
    None
}

#[cfg(test)]
mod tests {
    use luxel_core::ColorSpace;

    use super::*;

    #[test]
    fn colours_of_a_display_are_no_light_to_add() {
        let scene = |color_space| Scene { color_space, ..crate::synthetic::room(20, 1).into_core() };
        let mixed = |color_space| mix(["a", "b"].map(|name| MixInput { name: name.into(), scene: scene(color_space), weight: 0.5 }).into());
        assert!(mixed(ColorSpace::LinearRec709).is_ok());
        let error = mixed(ColorSpace::DisplaySrgb).unwrap_err();
        assert!(error.to_string().starts_with("a: its colours are a display's (display-srgb), expected light"), "{error}");
    }
}
