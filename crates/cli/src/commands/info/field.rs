//! The description of a radiance field.

use luxel::field::{ColorHead, FieldNetwork, FieldScene};

use crate::output::tree::Tree;

/// Adds the size and the place of a radiance field.
pub(super) fn add_to(facts: &mut Tree, scene: &FieldScene) {
    let shape = scene.field.shape();
    facts.set("parameters", scene.field.parameter_count());
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
    facts.set("cube_side", shape.space.side * scene.place.world_from_local.scale());
    facts.set("occupied_part", scene.field.occupied_part());
    facts.set("radiance_scale", scene.place.radiance_scale.get());
    facts.set("color_space", scene.place.color_space.name());
}
