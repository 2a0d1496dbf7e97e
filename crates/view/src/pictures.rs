//! Pictures: what is asked for, and the answers that are made from it.

use bytes::Bytes;
use hyper::StatusCode;
use luxel::Radiance;
use luxel_app::schema;
use luxel_core::{Camera, OnDemand};
use serde_json::{Value, json};

use crate::answer::{Answer, Failure};
use crate::frame::Planes;
use crate::jobs::{Rendered, Wanted};
use crate::lens::LensRequest;
use crate::query::Query;
use crate::server_context::{ServerContext, beside, render, render_surely};
use crate::stage::check_edits;
use crate::variant::Variant;

/// Pixels of a picture for the page, at most.
const MAX_FRAME_PX: u64 = 1 << 25;
/// Bytes of a pixel in OpenEXR, at most.
const EXR_PIXEL_BYTES: usize = 20;

/// Takes camera, size and edits out of a query.
pub(crate) fn wanted(context: &ServerContext, query: &mut Query) -> Result<Wanted, Failure> {
    let size: [Option<u32>; 2] = [query.number("width")?, query.number("height")?];
    let edit = query.take("edit").unwrap_or_default();
    check_edits(context.edit_session.as_deref(), &edit)?;
    let variant = Variant::take(query, context.subject.scenes())?;
    let camera = match (query.take("view"), query.take("camera")) {
        (Some(name), None) => {
            let camera = context.subject.view(&name).map_err(|message| Failure::new(StatusCode::NOT_FOUND, message))?.camera();
            match size {
                [None, None] => context.subject.to_scene(&camera, variant.scene),
                [width, height] => {
                    let size = [width.unwrap_or(camera.size_px[0]), height.unwrap_or(camera.size_px[1])];
                    context.subject.to_scene(&resized(&camera, size), variant.scene)
                }
            }
        }
        (None, Some(text)) => context.subject.local_camera(&camera_of(&text, size)?, variant.scene),
        _ => {
            return Err(String::from(
                "expected one of \"view\" (a name of /api/scene) and \"camera\" (JSON as a frame of transforms.json)",
            )
            .into());
        }
    };
    camera.validate().map_err(|error| format!("camera: {error}"))?;
    let lens = LensRequest::take(query)?;
    if lens.is_some() && (variant.solids.is_some() || !camera.projection.is_pinhole()) {
        return Err(String::from("a lens needs blended splats and the projection of a pinhole").into());
    }
    Ok(Wanted { camera, edit, layers: false, variant, lens })
}

/// Returns a camera with the same field of view and another number of pixels.
fn resized(camera: &Camera, size_px: [u32; 2]) -> Camera {
    let factor =
        glam::DVec2::new(f64::from(size_px[0]) / f64::from(camera.size_px[0]), f64::from(size_px[1]) / f64::from(camera.size_px[1]));
    Camera { focal_px: camera.focal_px * factor, center_px: camera.center_px * factor, size_px, ..camera.clone() }
}

/// Reads a camera as a frame of `transforms.json` has it.
pub(crate) fn camera_of(text: &str, size: [Option<u32>; 2]) -> Result<Camera, Failure> {
    let mut frame: Value = serde_json::from_str(text).map_err(|error| format!("\"camera\" is not JSON: {error}"))?;
    let Value::Object(fields) = &mut frame else { return Err(String::from("\"camera\" is not a JSON object").into()) };
    for (name, side) in ["w", "h"].into_iter().zip(size) {
        if let Some(side) = side {
            fields.insert(name.into(), side.into());
        }
    }
    let cameras = luxel::decode_cameras("camera", json!({ "frames": [frame] }).to_string().as_bytes());
    let mut cameras = cameras.map_err(|error| format!("{error:#}"))?;
    Ok(cameras.remove(0).camera)
}

/// The planes that a request asks for.
#[derive(Clone, Copy, Debug)]
struct Channels {
    rgb: bool,
    alpha: bool,
    depth: bool,
}

/// Takes the names of channels out of a query.
fn channels(query: &mut Query) -> Result<Channels, Failure> {
    let text = query.take("channels").unwrap_or_else(|| "rgb".into());
    let mut channels = Channels { rgb: false, alpha: false, depth: false };
    for name in text.split(',') {
        match name {
            "rgb" => channels.rgb = true,
            "alpha" => channels.alpha = true,
            "depth" => channels.depth = true,
            other => return Err(format!("unknown channel \"{}\", expected rgb, depth, alpha", other.escape_default()).into()),
        }
    }
    Ok(channels)
}

/// Answers with radiance, coverage and depth as the page takes them.
pub(crate) async fn frame(context: &ServerContext, query: &mut Query) -> Result<Answer, Failure> {
    let Channels { rgb, alpha, depth } = channels(query)?;
    let viewer = query.take("viewer").filter(|viewer| !viewer.is_empty());
    let wanted = Wanted { layers: alpha || depth, ..wanted(context, query)? };
    let [width, height] = wanted.camera.size_px;
    if u64::from(width) * u64::from(height) > MAX_FRAME_PX {
        return Err(format!("{width} x {height} pixels, expected at most {MAX_FRAME_PX} in all").into());
    }
    let Some(Rendered { picture, version, seconds }) = render(context, wanted, viewer).await? else {
        return Ok(Answer { status: StatusCode::NO_CONTENT, ..Answer::new("application/octet-stream", Bytes::new()) });
    };
    let pixel_bytes = [(rgb, 6), (alpha, 2), (depth, 4)].iter().filter(|(is_asked, _)| *is_asked).map(|(_, bytes)| bytes).sum();
    let permit = context.permits.acquire(answer_bytes(&picture.radiance, pixel_bytes)).await?;
    let frame = beside(move || {
        let size = [picture.radiance.width(), picture.radiance.height()];
        let light = picture.radiance.light();
        let planes = Planes {
            pixels: if rgb { light.pixels() } else { &[] },
            alpha: if alpha { &picture.alpha } else { &[] },
            depth: if depth { &picture.depth } else { &[] },
        };
        planes.encode(size, version, seconds)
    });
    let frame = frame.await?;
    Answer::frame(&frame.head, permit.fill(frame.body))
}

/// Returns the size of an answer with so many bytes for each pixel.
pub(crate) fn answer_bytes(radiance: &Radiance, pixel_bytes: usize) -> usize {
    radiance.pixels().len() * pixel_bytes
}

/// Answers with OpenEXR, as `luxel render` writes it.
pub(crate) async fn exr(context: &ServerContext, query: &mut Query) -> Result<Answer, Failure> {
    let Channels { alpha, depth, .. } = channels(query)?;
    let wanted = Wanted { layers: alpha || depth, ..wanted(context, query)? };
    let Rendered { picture, .. } = render_surely(context, wanted).await?;
    if (alpha || depth) && picture.alpha.is_empty() {
        return Err(Failure::new(
            StatusCode::UNPROCESSABLE_ENTITY,
            "this engine renders no depth and alpha; start the viewer with the CPU's",
        ));
    }
    let permit = context.permits.acquire(answer_bytes(&picture.radiance, EXR_PIXEL_BYTES)).await?;
    let file = beside(move || picture.encode_exr(alpha, depth)).await?;
    let file = file.map_err(|error| Failure::new(StatusCode::UNPROCESSABLE_ENTITY, format!("{error:#}")))?;
    Ok(Answer { file_name: Some("view.exr"), ..Answer::new("image/x-exr", permit.fill(file)) })
}

/// Answers with what a pixel holds.
pub(crate) async fn probe(context: &ServerContext, query: &mut Query) -> Result<Answer, Failure> {
    let mut place =
        |name: &str| query.number::<u32>(name).and_then(|at| at.ok_or_else(|| format!("\"{name}\" is missing, expected a column or row")));
    let [x, y] = [place("x")?, place("y")?];
    let wanted = Wanted { layers: true, ..wanted(context, query)? };
    let camera = context.subject.to_world(&wanted.camera, wanted.variant.scene);
    let weights = context.subject.luminance_weights(wanted.variant.scene);
    let [width, height] = camera.size_px;
    if x >= width || y >= height {
        return Err(format!("pixel {x}, {y} is outside of {width} x {height}").into());
    }
    let Rendered { picture, version, .. } = render_surely(context, wanted).await?;
    let Some(radiance) = picture.radiance.light().pixel(x as usize, y as usize) else {
        return Err(String::from("the pixel is missing").into());
    };
    let luminance: f64 = radiance.iter().zip(weights).map(|(value, weight)| f64::from(*value) * weight).sum();
    let index = (y * width + x) as usize;
    let depth = picture.depth.get(index).copied().filter(|depth| depth.is_finite());
    let position = depth.map(|depth| world_of(&camera, [x, y], depth.into()).to_array());
    Answer::json(&schema::VIEW.versioned(json!({
        "radiance": radiance, "luminance": luminance, "depth": depth, "position": position,
        "alpha": picture.alpha.get(index), "x": x, "y": y, "version": version,
    })))
}

/// Returns the point in the world that a pixel shows at a depth.
fn world_of(camera: &Camera, [x, y]: [u32; 2], depth: f64) -> glam::DVec3 {
    let pixel = glam::DVec2::new(f64::from(x) + 0.5, f64::from(y) + 0.5);
    camera.eye() + camera.camera_from_world.matrix3.transpose() * (camera.unproject(pixel).unwrap_or_default() * depth)
}

/// Answers with the ground truth of a camera.
pub(crate) async fn truth(context: &ServerContext, query: &mut Query) -> Result<Answer, Failure> {
    let name = query.take("view").ok_or_else(|| String::from("\"view\" is missing, expected a name of /api/scene"))?;
    let view = context.subject.view(&name).map_err(|message| Failure::new(StatusCode::NOT_FOUND, message))?;
    let Some(image) = &view.truth else {
        return Err(Failure::new(StatusCode::UNPROCESSABLE_ENTITY, "the images of this data set are captured LDR values, not radiance"));
    };
    let unreadable = |error: luxel_core::ReadError| Failure::new(StatusCode::UNPROCESSABLE_ENTITY, error.to_string());
    let (image, mask) = (&image.loaded().map_err(unreadable)?, view.mask.as_ref().map(OnDemand::loaded).transpose().map_err(unreadable)?);
    let weights = mask.as_ref().map_or(&[][..], |mask| &mask.weights);
    let permit = context.permits.acquire(8 * image.pixels.len()).await?;
    let frame = Planes::of_image(image, weights).encode([image.width, image.height], 0, 0.0);
    Answer::frame(&frame.head, permit.fill(frame.body))
}
