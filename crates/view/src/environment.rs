//! Light probes: the light that arrives at a point, as an environment map.
//!
//! In: a point in the world, a width, edits. Out: what `luxel probe --at` makes of the same scene:
//! its file, byte for byte, its pixels for the page, and its light summed up with what is doubtful
//! about it. The last one is kept, so that showing and saving it costs one render. It is rendered
//! camera by camera, so that pages see pictures in between, and ends with the connection of the one
//! that asked for it.

use std::sync::Arc;

use hyper::{Method, StatusCode};
use luxel::probe::{ProbeWork, unseen};
use luxel::{Camera, Probe, ProbeOptions};
use luxel_app::schema;
use luxel_io::ExrSample;
use serde_json::json;

use crate::answer::{Answer, Failure};
use crate::frame::Planes;
use crate::jobs::{Loaded, Stage};
use crate::probe_map::{Environment, ProbeRequest, Progress};
use crate::query::Query;
use crate::server_context::{ServerContext, beside, on_stage};
use crate::stage::check_edits;
use crate::subject::Shown;

/// Widths that a map may have, pixels, and that of one that states none.
const WIDTHS: std::ops::RangeInclusive<usize> = 4..=8192;
const DEFAULT_WIDTH: usize = 2048;

impl ProbeRequest {
    fn take(context: &ServerContext, query: &mut Query) -> Result<Self, Failure> {
        let at = point_of(query)?;
        let width = query.number("width")?.unwrap_or(DEFAULT_WIDTH);
        if !WIDTHS.contains(&width) {
            return Err(format!("\"width\" is {width}, expected {} to {} pixels", WIDTHS.start(), WIDTHS.end()).into());
        }
        let edit = query.take("edit").unwrap_or_default();
        check_edits(context.edit_session.as_deref(), &edit)?;
        Ok(Self { at, width, edit })
    }
}

/// Takes the point `at` of the world.
pub(crate) fn point_of(query: &mut Query) -> Result<[f64; 3], Failure> {
    let text = query.take("at").unwrap_or_default();
    let numbers: Vec<f64> = text.split(',').filter_map(|part| part.trim().parse().ok()).filter(|v: &f64| v.is_finite()).collect();
    let (Ok(at), 3) = (<[f64; 3]>::try_from(numbers), text.split(',').count()) else {
        let shown: String = text.chars().take(80).collect();
        return Err(format!("\"at\" is \"{}\", expected x,y,z in the world", shown.escape_default()).into());
    };
    Ok(at)
}

/// Bytes of a pixel of the map for the page.
const FRAME_PIXEL_BYTES: usize = 6;
/// Bytes of a pixel of the map in OpenEXR, at most.
const EXR_PIXEL_BYTES: usize = 12;

/// Answers requests below `/api/environment`.
pub(crate) async fn answer(context: &Arc<ServerContext>, method: &Method, path: &str, query: &mut Query) -> Result<Answer, Failure> {
    let is_get = *method == Method::GET;
    match path {
        "/api/environment" if is_get => {
            let environment = environment(context, ProbeRequest::take(context, query)?).await?;
            Answer::json(&schema::VIEW.versioned(described(&environment)))
        }
        "/api/environment/progress" if is_get => {
            let progress = context.environment.progress(&ProbeRequest::take(context, query)?);
            Answer::json(&schema::VIEW.versioned(json!({ "done": progress.done, "total": progress.total })))
        }
        "/api/environment.frame" if is_get => {
            let environment = environment(context, ProbeRequest::take(context, query)?).await?;
            let permit = context.permits.acquire(FRAME_PIXEL_BYTES * environment.probe.image().pixels.len()).await?;
            let encode = move || Planes::of_image(environment.probe.image(), &[]).encode(size(&environment.probe), 0, 0.0);
            let frame = beside(encode).await?;
            Answer::frame(&frame.head, permit.fill(frame.body))
        }
        "/api/environment.exr" if is_get => {
            let environment = environment(context, ProbeRequest::take(context, query)?).await?;
            let permit = context.permits.acquire(EXR_PIXEL_BYTES * environment.probe.image().pixels.len()).await?;
            let file = beside(move || exr(&environment.probe)).await??;
            Ok(Answer { file_name: Some("probe.exr"), ..Answer::new("image/x-exr", permit.fill(file)) })
        }
        "/api/environment/save" if *method == Method::POST => {
            let name = query.take("name").ok_or_else(|| String::from("\"name\" is missing, expected that of the file"))?;
            crate::folder::check_name(&name)?;
            let request = ProbeRequest::take(context, query)?;
            let folder = context.folder()?;
            let environment = environment(context, request).await?;
            let path = beside(move || folder.new_file("probes", &name, "exr", &exr(&environment.probe)?)).await??;
            Answer::json(&json!({ "path": path.display().to_string() }))
        }
        "/api/environment" | "/api/environment/progress" | "/api/environment.frame" | "/api/environment.exr" | "/api/environment/save" => {
            Err(Failure::new(StatusCode::METHOD_NOT_ALLOWED, "GET reads a probe, POST /api/environment/save saves it"))
        }
        _ => Err(Failure::new(StatusCode::NOT_FOUND, "no such path")),
    }
}

fn size(probe: &Probe) -> [usize; 2] {
    [probe.width(), probe.height()]
}

fn exr(probe: &Probe) -> luxel::Result<Vec<u8>> {
    probe.encode_exr(ExrSample::smallest_for(probe.image()))
}

fn described(Environment { probe, warnings }: &Environment) -> serde_json::Value {
    let summary = &probe.summary;
    json!({
        "width": probe.width(), "height": probe.height(), "color_space": probe.color_space().name(), "warnings": warnings,
        "mean_radiance": summary.mean_radiance, "peak_radiance": summary.peak_radiance, "peak_direction": summary.peak_direction,
        "irradiance": summary.irradiance, "lights": probe.lights.iter().map(luxel::probe::light_json).collect::<Vec<_>>(),
    })
}

/// Returns a probe: the last one, or a new one in its place.
async fn environment(context: &Arc<ServerContext>, request: ProbeRequest) -> Result<Arc<Environment>, Failure> {
    let mut last = context.environment.last.lock().await;
    if let Some((_, environment)) = last.as_ref().filter(|(known, _)| *known == request) {
        return Ok(Arc::clone(environment));
    }
    // One map in memory at a time.
    *last = None;
    let under_way = context.environment.begin(&request);
    let (mut work, warnings) = begin(context, &request).await?;
    while !work.is_done() {
        under_way.set(Progress { done: work.cameras_done(), total: work.cameras() });
        let edit = request.edit.clone();
        let render = move |stage: &mut dyn Stage| {
            work.render_next(stage.loaded(&edit)?.renderer)?;
            Ok(work)
        };
        work = on_stage(context, render).await?;
    }
    let environment = Arc::new(Environment { probe: beside(move || work.finish()).await?, warnings });
    *last = Some((request, Arc::clone(&environment)));
    Ok(environment)
}

async fn begin(context: &Arc<ServerContext>, request: &ProbeRequest) -> Result<(ProbeWork, Vec<String>), Failure> {
    let (shared, request) = (Arc::clone(context), request.clone());
    let begin = move |stage: &mut dyn Stage| {
        let Loaded { scene, .. } = stage.loaded(&request.edit)?;
        let options = ProbeOptions { width_px: request.width, ..ProbeOptions::at(request.at) };
        let subject = &shared.subject;
        let cameras: Vec<Camera> = subject.views.iter().filter(|view| view.split == "train").map(Shown::camera).collect();
        let mut warnings: Vec<String> = unseen(scene, &cameras.iter().collect::<Vec<_>>(), request.at).into_iter().collect();
        if cameras.is_empty() {
            warnings.push("no data set: rendered at the resolution of the map, at which small lights may be off".into());
        }
        Ok((ProbeWork::new(scene, &options, subject.surroundings)?, warnings))
    };
    on_stage(context, begin).await
}
