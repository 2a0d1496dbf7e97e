//! Small pictures of the cameras' ground truth, as JPEG.

use hyper::StatusCode;
use luxel::preview::{self, Look};
use luxel_core::{ColorSpace, Image};

use crate::answer::{Answer, Failure};
use crate::query::Query;
use crate::server_context::{ServerContext, beside};

/// Height, pixels.
const HEIGHT_PX: usize = 96;
/// Quality of the JPEG.
const QUALITY: u8 = 85;

/// Answers with the thumbnail of a view.
pub(crate) async fn answer(context: &ServerContext, query: &mut Query) -> Result<Answer, Failure> {
    let name = query.take("view").ok_or_else(|| String::from("\"view\" is missing, expected a name of /api/scene"))?;
    let view = context.subject.view(&name).map_err(|message| Failure::new(StatusCode::NOT_FOUND, message))?;
    let Some(image) = view.truth.clone() else { return Err(Failure::new(StatusCode::NOT_FOUND, "the view has no radiance")) };
    let (scale, space) = (context.subject.facts.radiance_scale, context.color_space);
    let encoded = beside(move || jpeg(&*image.loaded().map_err(|error| error.to_string())?, scale, space)).await?;
    Ok(Answer::new("image/jpeg", encoded.map_err(|message| Failure::new(StatusCode::UNPROCESSABLE_ENTITY, message))?))
}

/// Encodes a small picture of a view's ground truth, beside a scene of this space.
pub(crate) fn jpeg(image: &Image, radiance_scale: f32, space: ColorSpace) -> Result<Vec<u8>, String> {
    let mut small = image.block_means((image.height / HEIGHT_PX).min(image.width).max(1));
    small.scale(radiance_scale.recip());
    // Images are light, also of scenes whose colours are a display's.
    preview::encode_jpeg(&small, space.linear(), &Look::usual(space), QUALITY).map_err(|error| format!("{error:#}"))
}
