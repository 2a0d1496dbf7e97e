//! Paths below `/api/edit/`: histograms and selections of splats, overlays, masks, saved edits.
//!
//! In: queries, and bodies of `POST`; out: JSON and pictures. A few requests work at a time; more
//! are refused rather than kept waiting, as the page asks again for what it still needs.

use std::sync::Arc;

use bytes::Bytes;
use hyper::{Method, StatusCode};
use luxel::edit::RemovalReason;
use luxel_app::schema;
use luxel_core::Camera;
use luxel_core::edit::{EditStack, SelectionSummary};
use serde::Deserialize;
use serde_json::{Value, json};

use crate::answer::{Answer, Failure};
use crate::edit_session::{EXTENSION, EditSession, Question};
use crate::pictures::camera_of;
use crate::query::Query;
use crate::server_context::{ServerContext, beside, try_beside};

/// Bins of the histogram of luminance.
const BINS: usize = 160;
/// Largest picture of an overlay or mask, pixels.
const MAX_PX: u64 = 1 << 24;
/// Bytes of a pixel of an overlay, at most.
const OVERLAY_PIXEL_BYTES: usize = 3;
/// Bytes of a request to save, at most.
const MAX_REQUEST_BYTES: usize = 1 << 20;
/// The first bytes of a PNG.
const PNG: [u8; 8] = *b"\x89PNG\r\n\x1a\n";

/// A request to save.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct SaveRequest {
    name: String,
    edit: String,
    /// Whether the edited scene is written.
    #[serde(default)]
    scene: bool,
    /// Whether the edits are written.
    #[serde(default)]
    stack: bool,
}

/// Answers a request below `/api/edit/`; `path` is what follows.
pub(crate) async fn answer(
    context: &Arc<ServerContext>,
    method: &Method,
    path: &str,
    query: &mut Query,
    body: Bytes,
) -> Result<Answer, Failure> {
    let Some(session) = &context.edit_session else {
        return Err(Failure::new(StatusCode::CONFLICT, "a scene that is being trained cannot be edited"));
    };
    let Ok(_place) = context.editing.try_acquire() else {
        return Err(Failure::new(StatusCode::SERVICE_UNAVAILABLE, "too many edits are worked on, try again"));
    };
    let session = Arc::clone(session);
    let is_get = *method == Method::GET;
    match path {
        "luminance" if is_get => luminance(session, query).await,
        "selection" if is_get => selection(session, query).await,
        "overlay.png" if is_get => overlay(context, session, query).await,
        "floaters" if is_get => floaters(session).await,
        "saved" if is_get => {
            let names = beside(move || session.saved()).await?;
            Answer::json(&schema::VIEW.versioned(json!({ "names": names })))
        }
        "stack" if is_get => {
            let name = query.take("name").unwrap_or_default();
            let stack = try_beside(move || session.open_stack(&name)).await?;
            Answer::json(&schema::VIEW.versioned(json!({ "edit": stack.to_string() })))
        }
        "mask" if *method == Method::POST => mask(session, query, body).await,
        "save" if *method == Method::POST => save(session, body).await,
        "read" if *method == Method::POST => read(session, body).await,
        "luminance" | "selection" | "overlay.png" | "floaters" | "saved" | "stack" | "mask" | "save" | "read" => {
            Err(Failure::new(StatusCode::METHOD_NOT_ALLOWED, "mask, save and read answer POST, all others GET"))
        }
        _ => Err(Failure::new(StatusCode::NOT_FOUND, "no such path")),
    }
}

/// Takes the edits before, and a selection, out of a query.
fn question(session: &EditSession, query: &mut Query) -> Result<Question, Failure> {
    let before = session.parse(&query.take("edit").unwrap_or_default())?;
    let selection = match (query.take("where"), query.take("floaters")) {
        (Some(text), None) => Some(session.parse_selection(&text)?),
        (None, Some(_)) => None,
        _ => return Err(String::from("expected one of \"where\" (a selection) and \"floaters\"").into()),
    };
    Ok(Question { before, selection })
}

fn facts(summary: &SelectionSummary) -> Value {
    json!({ "count": summary.count, "partial": summary.partial, "share_of_light": summary.light_share, "bounds": summary.bounds })
}

async fn selection(session: Arc<EditSession>, query: &mut Query) -> Result<Answer, Failure> {
    let question = question(&session, query)?;
    let selected = try_beside(move || session.selected(&question)).await?;
    Answer::json(&schema::VIEW.versioned(facts(&selected.summary)))
}

async fn overlay(context: &ServerContext, session: Arc<EditSession>, query: &mut Query) -> Result<Answer, Failure> {
    let question = question(&session, query)?;
    let camera = context.subject.local_camera(&camera_in(query)?, 0);
    let [width, height] = camera.size_px.map(|side| side as usize);
    let permit = context.permits.acquire(width * height * OVERLAY_PIXEL_BYTES).await?;
    let drawn = try_beside(move || {
        let selected = session.selected(&question)?;
        Ok((session.overlay(&selected.weights, &camera)?, selected.summary))
    });
    let (png, summary) = drawn.await?;
    Ok(Answer { frame_head: Some(facts(&summary).to_string()), ..Answer::new("image/png", permit.fill(png)) })
}

/// Takes a camera of the world and its size out of a query.
fn camera_in(query: &mut Query) -> Result<Camera, Failure> {
    let size: [Option<u32>; 2] = [query.number("width")?, query.number("height")?];
    let text = query.take("camera").ok_or_else(|| String::from("\"camera\" is missing, expected JSON as a frame of transforms.json"))?;
    let camera = camera_of(&text, size)?;
    camera.validate().map_err(|error| format!("camera: {error}"))?;
    let [width, height] = camera.size_px;
    match u64::from(width) * u64::from(height) <= MAX_PX {
        true => Ok(camera),
        false => Err(format!("{width} x {height} pixels, expected at most {MAX_PX} in all").into()),
    }
}

async fn floaters(session: Arc<EditSession>) -> Result<Answer, Failure> {
    let found = try_beside(move || {
        let found = session.floaters()?;
        let share = found.share_of_light(session.scene());
        Ok((found, share))
    });
    let (found, share) = found.await?;
    Answer::json(&schema::VIEW.versioned(json!({
        "count": found.count(), "share_of_light": share, "words": found.in_words(),
        "unseen": found.count_of(RemovalReason::Unseen), "isolated": found.count_of(RemovalReason::Isolated),
        "haze": found.count_of(RemovalReason::Haze),
    })))
}

/// Answers with the histogram of the splats' luminance after the edits.
async fn luminance(session: Arc<EditSession>, query: &mut Query) -> Result<Answer, Failure> {
    let stack = session.parse(&query.take("edit").unwrap_or_default())?;
    let before = EditStack { edits: stack.edits, ..EditStack::default() };
    let values = try_beside(move || {
        let scene = session.edited(&before)?;
        Ok((0..scene.splats.len()).map(|i| scene.luminance(i)).collect())
    });
    Answer::json(&schema::VIEW.versioned(histogram(values.await?)))
}

/// Counts values in equal steps of their logarithm, with each hundredth of them by rank.
fn histogram(mut values: Vec<f32>) -> Value {
    values.sort_unstable_by(f32::total_cmp);
    let last = values.len().saturating_sub(1);
    let rank = |percent: f64| values.get((percent / 100.0 * last as f64).round() as usize).copied().unwrap_or(0.0);
    let percentiles: Vec<f32> = (0..=100).map(|percent| rank(f64::from(percent))).collect();
    let lit = values.partition_point(|value| *value <= 0.0);
    // A few black splats would take most of the axis.
    let low = f64::from(rank(0.5).max(values.get(lit).copied().unwrap_or(1.0))).log2().floor();
    let high = f64::from(values.last().copied().filter(|value| *value > 0.0).unwrap_or(1.0)).log2().ceil().max(low + 1.0);
    let mut bins = vec![0usize; BINS];
    for value in values.iter().filter(|value| **value > 0.0) {
        let at = (f64::from(*value).log2() - low) / (high - low) * BINS as f64;
        bins[(at.max(0.0) as usize).min(BINS - 1)] += 1;
    }
    json!({ "count": values.len(), "black": lit, "low_log2": low, "high_log2": high, "bins": bins, "percentiles": percentiles })
}

/// Keeps a painted mask, and answers with the names of its files.
async fn mask(session: Arc<EditSession>, query: &mut Query, body: Bytes) -> Result<Answer, Failure> {
    let camera = camera_in(query)?;
    let saved = try_beside(move || {
        if !body.starts_with(&PNG) {
            return Err(luxel::Error::new("the mask is no PNG"));
        }
        let decoded = luxel_io::decode_codes("mask.png".as_ref(), &body).map_err(|error| luxel::Error::new(error.to_string()))?;
        let [width, height] = camera.size_px.map(|side| side as usize);
        if [decoded.image.width, decoded.image.height] != [width, height] {
            let found = [decoded.image.width, decoded.image.height];
            return Err(luxel::Error::new(format!("a mask of {} x {} pixels, expected {width} x {height}", found[0], found[1])));
        }
        let camera = luxel::PathCamera::new("mask", camera);
        let name = session.save_mask(&body, &luxel_io::camera_file_text(&[camera]))?;
        let path = |extension: &str| session.place().join(format!("{name}.{extension}")).display().to_string();
        Ok([path("png"), path("json")])
    });
    let [file, view] = saved.await?;
    Answer::json(&schema::VIEW.versioned(json!({ "file": file, "view": view })))
}

async fn save(session: Arc<EditSession>, body: Bytes) -> Result<Answer, Failure> {
    if body.len() > MAX_REQUEST_BYTES {
        return Err(Failure::new(StatusCode::PAYLOAD_TOO_LARGE, format!("expected at most {MAX_REQUEST_BYTES} bytes of JSON")));
    }
    let request: SaveRequest = serde_json::from_slice(&body).map_err(|error| format!("the body is no request to save: {error}"))?;
    if !request.scene && !request.stack {
        return Err(String::from("nothing to save: set \"scene\" or \"stack\"").into());
    }
    let saved = try_beside(move || {
        let stack = session.parse(&request.edit)?;
        if stack.is_empty() {
            return Err(luxel::Error::new("nothing to save: there are no edits"));
        }
        let name = request.name.strip_suffix(&format!(".{EXTENSION}")).unwrap_or(&request.name);
        let name = name.strip_suffix(".ply").unwrap_or(name);
        let scene = request.scene.then(|| session.save_scene(name, &stack)).transpose()?;
        let file = request.stack.then(|| session.save_stack(name, &stack)).transpose()?;
        Ok([scene, file].map(|path| path.map(|path| path.display().to_string())))
    });
    let [scene, stack] = saved.await?;
    Answer::json(&schema::VIEW.versioned(json!({ "scene": scene, "stack": stack })))
}

/// Answers with the stack that the text of a file of edits holds.
async fn read(session: Arc<EditSession>, body: Bytes) -> Result<Answer, Failure> {
    if body.len() > MAX_REQUEST_BYTES {
        return Err(Failure::new(StatusCode::PAYLOAD_TOO_LARGE, format!("expected at most {MAX_REQUEST_BYTES} bytes of edits")));
    }
    let text = String::from_utf8(body.into()).map_err(|_| String::from("expected text, a file of edits"))?;
    let stack = try_beside(move || session.parse_file(&text)).await?;
    Answer::json(&schema::VIEW.versioned(json!({ "edit": stack.to_string() })))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_histogram_counts_every_splat_with_light() {
        let found = histogram(vec![0.0, 1.0, 2.0, 4.0, 0.5]);
        assert_eq!((&found["count"], &found["black"], &found["high_log2"]), (&json!(5), &json!(1), &json!(2.0)));
        let total: u64 = found["bins"].as_array().unwrap().iter().filter_map(Value::as_u64).sum();
        assert_eq!(total, 4);
        assert_eq!(found["percentiles"][50], json!(1.0));
        assert_eq!(histogram(Vec::new())["count"], json!(0));
        assert_eq!(histogram(vec![0.0; 3])["black"], json!(3));
    }
}
