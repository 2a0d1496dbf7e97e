//! Copies of the scene for pages that render by themselves.
//!
//! In: a request with edits and a precision; out: the splats ([`crate::splats`]), packed on the
//! thread that owns the scene, or what the edits change of them ([`crate::changes`]). The scene
//! without edits is packed once; of others, of large ones, and of changes only a few are on their
//! way at a time.

use std::sync::Arc;

use bytes::Bytes;
use hyper::StatusCode;
use tokio::sync::OwnedSemaphorePermit;

use crate::answer::{Answer, Failure};
use crate::jobs::{Loaded, Stage};
use crate::query::Query;
use crate::server_context::{ServerContext, on_stage, try_beside};
use crate::splats::{Precision, body_bytes, pack};
use crate::stage::check_edits;

/// Largest scene of which a copy for pages is kept, bytes.
const MAX_KEPT_BYTES: u64 = 256 << 20;

/// Answers with the splats, for a page that renders by itself.
pub(crate) async fn splats(context: &ServerContext, query: &mut Query) -> Result<Answer, Failure> {
    let edit = query.take("edit").unwrap_or_default();
    check_edits(context.edit_session.as_deref(), &edit)?;
    let precision = match query.take("precision").as_deref() {
        None | Some("half") => Precision::Half,
        Some("single") => Precision::Single,
        Some(other) => return Err(format!("unknown precision \"{}\", expected half, single", other.escape_default()).into()),
    };
    let Some(scene) = &context.scene else {
        return Err(Failure::new(StatusCode::CONFLICT, "the scene is being trained, and is rendered here"));
    };
    if scene.splats.color_model.lights() > 1 {
        return Err(Failure::new(StatusCode::CONFLICT, "the scene is a mix of lights, and is rendered here"));
    }
    let is_kept = edit.is_empty() && precision == Precision::Half && body_bytes(&scene.splats, precision) <= MAX_KEPT_BYTES;
    let packed = async {
        let work = move |stage: &mut dyn Stage| {
            let Loaded { scene, renderer } = stage.loaded(&edit)?;
            Ok(pack(scene, renderer.options(), precision))
        };
        on_stage(context, work).await
    };
    let body = if is_kept {
        context.downloads.kept.get_or_try_init(|| packed).await?.clone()
    } else {
        let place = place(context)?;
        Bytes::from_owner(Download { body: packed.await?, _place: place })
    };
    Ok(Answer::new("application/octet-stream", body))
}

/// Answers with the changes that edits make, for a page that has the splats.
pub(crate) async fn changes(context: &ServerContext, query: &mut Query) -> Result<Answer, Failure> {
    let edit = query.take("edit").unwrap_or_default();
    let Some(session) = context.edit_session.clone() else {
        return Err(Failure::new(StatusCode::CONFLICT, "the scene is being trained, and is rendered here"));
    };
    let stack = session.parse(&edit)?;
    let place = place(context)?;
    let body = try_beside(move || session.changes(&stack)).await?;
    Ok(Answer::new("application/octet-stream", Bytes::from_owner(Download { body, _place: place })))
}

/// Returns a place for a copy that is on its way.
fn place(context: &ServerContext) -> Result<OwnedSemaphorePermit, Failure> {
    let busy = |_| Failure::new(StatusCode::SERVICE_UNAVAILABLE, "too many scenes are being downloaded");
    Arc::clone(&context.downloads.places).try_acquire_owned().map_err(busy)
}

/// A copy of a scene that holds its place until it is sent.
struct Download {
    body: Bytes,
    _place: OwnedSemaphorePermit,
}

impl AsRef<[u8]> for Download {
    fn as_ref(&self) -> &[u8] {
        &self.body
    }
}
