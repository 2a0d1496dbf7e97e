//! The description of a radiance field, and of anchors.

use luxel::implicit::{ColorHead, Content, FieldNetwork, ImplicitScene};

use crate::output::tree::Tree;

/// Returns what a file of the scene holds.
pub(super) fn kind(scene: &ImplicitScene) -> &'static str {
    match scene.content {
        Content::Field(_) => "radiance field",
        Content::Anchors { .. } => "anchors",
    }
}

/// Adds the size and the place of a radiance field, or of anchors.
pub(super) fn add_to(facts: &mut Tree, scene: &ImplicitScene) {
    facts.set("parameters", scene.parameter_count());
    let length = scene.place.world_from_local.scale();
    match &scene.content {
        Content::Field(field) => {
            let shape = field.shape();
            match shape.network {
                FieldNetwork::Grid(grid) => {
                    facts.set("grid_levels", grid.levels);
                    facts.set("grid_entries", 1u32 << grid.log2_entries);
                    facts.set("finest_grid", grid.finest);
                }
                FieldNetwork::Layers { layers, units } => {
                    facts.set("layers", layers);
                    facts.set("units", units);
                }
            }
            facts.set(
                "colors",
                match shape.head {
                    ColorHead::Softplus => "radiance",
                    ColorHead::Log => "log radiance, with tone mappers",
                    ColorHead::Lifted => "captured values, lifted to radiance",
                },
            );
            facts.set("cube_side", shape.space.side * length);
            facts.set("occupied_part", field.occupied_part());
        }
        Content::Anchors { scene: anchors, response } => {
            facts.set("anchors", anchors.anchors.len());
            facts.set("splats", anchors.splats());
            facts.set("color_model", anchors.color_model().name());
            facts.set("camera_response", if response.is_some() { "learned" } else { "none" });
        }
    }
    facts.set("radiance_scale", scene.place.radiance_scale.get());
    facts.set("color_space", scene.place.color_space.name());
}
