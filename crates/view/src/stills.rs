//! Stills of a view that a browser cannot make by itself: HDR PNG.

use hyper::StatusCode;

use crate::answer::{Answer, Failure};
use crate::jobs::Rendered;
use crate::pictures::{answer_bytes, wanted};
use crate::query::Query;
use crate::server_context::{ServerContext, beside, render_surely};

/// Exposures that make sense, stops.
const EXPOSURES: std::ops::RangeInclusive<f32> = -64.0..=64.0;

/// Bytes of a pixel, at most.
const PIXEL_BYTES: usize = 6;

/// Answers with a picture in PQ; the exposure's white is reference white, 203 cd/m2.
pub(crate) async fn answer(context: &ServerContext, query: &mut Query) -> Result<Answer, Failure> {
    let exposure_ev = query.number::<f32>("exposure")?.unwrap_or(0.0);
    if !EXPOSURES.contains(&exposure_ev) {
        return Err(format!("\"exposure\" is {exposure_ev}, expected -64 to 64 stops").into());
    }
    if query.take("hdr").as_deref() != Some("pq") {
        return Err(String::from("expected hdr=pq: 16 bits, Rec.2020, the perceptual quantizer").into());
    }
    let Rendered { picture, .. } = render_surely(context, wanted(context, query)?).await?;
    let permit = context.permits.acquire(answer_bytes(&picture.radiance, PIXEL_BYTES)).await?;
    let file = beside(move || picture.radiance.encode_png_pq(exposure_ev)).await?;
    let file = file.map_err(|error| Failure::new(StatusCode::UNPROCESSABLE_ENTITY, format!("{error:#}")))?;
    Ok(Answer { file_name: Some("view-pq.png"), ..Answer::new("image/png", permit.fill(file)) })
}
