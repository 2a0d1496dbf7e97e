//! The light that falls onto an object at a point: lamps, and the rest as a small map.
//!
//! In: a point of the world, edits. Out: what `luxel lights --at` finds in the same scene, as JSON;
//! the map is small, since only objects that the page draws itself are lit by it. The last answer
//! is kept. The work is done by an engine of its own on the processor, so that pictures go on.

use std::sync::Arc;

use hyper::{Method, StatusCode};
use luxel::lights::{DomeOptions, LightOptions, SceneLights, lights_json, lights_seen_by};
use luxel::{Device, DeviceOptions, SelectedEngine, Silent};
use luxel_app::schema;
use luxel_core::Camera;
use serde_json::{Value, json};

use crate::answer::{Answer, Failure};
use crate::environment::point_of;
use crate::jobs::Stage;
use crate::probe_map::FoundLamps;
use crate::query::Query;
use crate::server_context::{ServerContext, on_stage, try_beside};
use crate::stage::check_edits;
use crate::subject::Shown;

/// Width of the map, pixels.
const WIDTH_PX: usize = 96;

/// Answers `/api/lamps`.
pub(crate) async fn answer(context: &Arc<ServerContext>, method: &Method, query: &mut Query) -> Result<Answer, Failure> {
    if *method != Method::GET {
        return Err(Failure::new(StatusCode::METHOD_NOT_ALLOWED, "GET finds lamps"));
    }
    let (at, edit) = (point_of(query)?, query.take("edit").unwrap_or_default());
    check_edits(context.edit_session.as_deref(), &edit)?;
    let mut last = context.lamps.last.lock().await;
    if let Some(known) = last.as_ref().filter(|known| known.at == at && known.edit == edit) {
        return Answer::json(&schema::VIEW.versioned(&known.answer));
    }
    let of_edit = edit.clone();
    let scene = on_stage(context, move |stage: &mut dyn Stage| Ok(stage.loaded(&of_edit)?.scene.clone())).await?;
    let cameras: Vec<Camera> = context.subject.views.iter().filter(|view| view.split == "train").map(Shown::camera).collect();
    let surroundings = context.subject.surroundings;
    let find = move || {
        let color_space = scene.color_space.linear();
        let dome = DomeOptions { at: Some(at), width_px: WIDTH_PX, ..DomeOptions::default() };
        let options = LightOptions { color_space, dome: Some(dome), ..LightOptions::default() };
        let mut engine = SelectedEngine::open(&DeviceOptions::from(Device::Cpu))?.engine;
        lights_seen_by(scene.into_core(), &cameras, surroundings, &options, engine.as_mut(), &Silent)
    };
    let lights = try_beside(find).await?;
    let found = last.insert(FoundLamps { at, edit, answer: described(&lights) });
    Answer::json(&schema::VIEW.versioned(&found.answer))
}

fn described(lights: &SceneLights) -> Value {
    let map = lights.dome.as_ref().map(|map| {
        let rows = map.map_from_world.transpose().to_cols_array_2d();
        json!({ "width": map.width(), "height": map.height(), "rgb": map.image().pixels.as_flattened(), "map_from_world": rows })
    });
    json!({ "lamps": lights_json(lights), "map": map, "unseen_share": lights.unseen_share, "left_in_map": lights.left_in_map })
}
