//! The radiometric viewer: a server that renders a scene, and a page that shows its radiance.
//!
//! In: a scene, a [`Renderer`], the data set's cameras and images ([`Subject`]). Out: a page at a
//! loopback address, and pictures of half floats ([`frame`](crate#frames)) that the page exposes,
//! tone-maps and measures. Nothing is read but what the caller hands over, and nothing is written
//! but new files in the folder of [`Subject::saving_to`].
//!
//! # Threads
//! The server has a thread of its own and never waits for the engine. The thread that owns the
//! engine takes jobs from a bounded queue, in which a page's newest wish replaces its older ones.
//!
//! # Frames
//! `GET /api/frame` answers with planes of little-endian numbers; the header `Luxel-Frame` is JSON
//! with width, height, the power of two that the half floats are multiplied by, and which planes
//! there are.
//!
//! # Safety
//! A loopback address is for this machine alone; any other needs the token of [`Viewer::url`].
//! Requests under a foreign `Host` or from a foreign `Origin` are refused.

/// The example of the crate's README, compiled as a doc test.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct CrateReadmeExample;

mod answer;
mod assets;
mod changes;
mod display;
mod downloads;
mod edit_session;
mod edits;
mod environment;
mod folder;
mod frame;
mod frame_render;
mod frame_status;
mod gate;
mod jobs;
mod lamps;
mod lens;
mod live;
mod page_file;
mod path_file;
mod paths;
mod pictures;
mod poster;
mod probe_map;
mod query;
mod response_permits;
mod routes;
mod server;
mod server_context;
pub mod solids;
mod splats;
mod stage;
mod status;
mod stills;
mod subject;
mod thumbnail;
mod variant;

use std::net::SocketAddr;
use std::sync::Arc;
use std::time::Duration;

use luxel::{Error, Remedy, Renderer, Result, Scene, StopFlag};

use crate::edit_session::EditSession;
use crate::gate::Gate;
pub use crate::live::Live;
pub use crate::page_file::{PageBytes, limit_degree, write_page};
use crate::server_context::ServerContext;
use crate::stage::{LastPicture, SceneStage, SceneStages};
use crate::status::Status;
pub use crate::subject::Subject;

/// The address that a viewer listens at by default.
pub const DEFAULT_ADDRESS: &str = "127.0.0.1:7007";

/// Time between looks at the stop flag while nobody asks for a picture.
const PATIENCE: Duration = Duration::from_millis(200);

/// A scene of the same place, to compare with, and the renderer that has loaded it.
pub struct Other {
    /// The name that the page has for it.
    pub name: String,
    /// The scene.
    pub scene: Scene,
    /// Its renderer.
    pub renderer: Renderer,
}

/// A viewer whose address is taken and which serves nothing yet; a browser that is early waits.
pub struct Viewer {
    listener: std::net::TcpListener,
    gate: Gate,
}

impl Viewer {
    /// Takes an address; port 0 is any free one.
    ///
    /// # Errors
    /// An address that is in use, or not one of this machine.
    pub fn bind(address: SocketAddr) -> Result<Self> {
        let cannot = |error: &dyn std::fmt::Display| Error::new(format!("{address}: cannot listen: {error}"));
        let remedy = || Remedy::set("listen", "another port, or port 0 for any");
        let listener = server::bind(address).map_err(|error| cannot(&error).with_remedy(remedy()))?;
        let address = listener.local_addr().map_err(|error| cannot(&error))?;
        let gate = Gate::new(address).map_err(|error| cannot(&error))?;
        Ok(Self { listener, gate })
    }

    /// Returns the address to open in a browser, with the token if one is needed.
    pub fn url(&self) -> String {
        self.gate.url()
    }

    /// Serves the scene that `renderer` has loaded until a stop is requested.
    ///
    /// # Errors
    /// The system refuses a thread.
    pub fn serve(self, subject: Subject, scene: Scene, renderer: Renderer, stop: &StopFlag) -> Result<()> {
        self.serve_beside(subject, scene, renderer, Vec::new(), stop)
    }

    /// Serves a scene as [`Self::serve`] does, with other scenes to compare it with.
    ///
    /// # Errors
    /// The system refuses a thread.
    pub fn serve_beside(self, mut subject: Subject, scene: Scene, renderer: Renderer, others: Vec<Other>, stop: &StopFlag) -> Result<()> {
        let mut stages = Vec::with_capacity(1 + others.len());
        let status = Status { splats: scene.splats.len(), ..Status::default() };
        let scene = Arc::new(scene);
        let session = Arc::new(EditSession::new(&subject, Arc::clone(&scene), renderer.options().background));
        stages.push(SceneStage::new(Arc::clone(&scene), renderer).with_edit_session(Arc::clone(&session)));
        for Other { name, scene: other, renderer } in others {
            subject.add_other(name, &scene, &other);
            stages.push(SceneStage::new(Arc::new(other), renderer));
        }
        let context = ServerContext::new(subject, scene.color_space, status, Some(Arc::clone(&scene)));
        let context = Arc::new(ServerContext { edit_session: Some(session), ..context });
        drop(scene);
        self.start(Arc::clone(&context))?;
        let mut stage = SceneStages(stages);
        let mut last = LastPicture::default();
        while !stop.is_requested() {
            if let Some(job) = context.jobs.next(PATIENCE) {
                last.answer(job, &mut stage);
            }
        }
        context.jobs.close();
        Ok(())
    }

    /// Starts the server's thread, which runs until the process ends.
    fn start(self, context: Arc<ServerContext>) -> Result<()> {
        let Self { listener, gate } = self;
        let cannot = |error: std::io::Error| Error::new(format!("cannot start the viewer: {error}"));
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().map_err(cannot)?;
        let serve = move || {
            runtime.block_on(async move {
                if let Ok(listener) = tokio::net::TcpListener::from_std(listener) {
                    server::serve(listener, Arc::new(gate), context).await;
                }
            });
        };
        std::thread::Builder::new().name("luxel-view".into()).spawn(serve).map_err(cannot)?;
        Ok(())
    }
}
