//! Training with a folder: what is saved when, how a run is resumed, and what it measured.
//!
//! [`fresh`] and [`resume`] start a run, [`Session`] is its loop, [`RunFolder`] knows where its
//! files are, [`RunConfig`] is its `config.toml`.
//!
//! ```
//! use luxel::{Device, Event, SelectedEngine, Silent, StopFlag, TrainConfig, synthetic};
//! use luxel_app::run::{self, Launch, Outcome, RunConfig, RunFolder};
//!
//! # fn main() -> luxel::Result<()> {
//! # let place = tempfile::tempdir().unwrap();
//! # let (my_images, my_run) = (place.path().join("data"), place.path().join("run"));
//! # synthetic::write_dataset(&my_images, synthetic::BallsOptions { side_px: 16, views: 4 })?;
//! let method = TrainConfig { iterations: 5, init_points: 50, ..TrainConfig::default() };
//! let config = RunConfig { device: Device::Cpu.into(), ..RunConfig::new(&my_images, method) };
//! let engine = SelectedEngine::for_training(&config.device, false)?;
//!
//! let folder = RunFolder::at(&my_run);
//! let observer = |event: Event| {
//!     if let Event::Evaluation { split, mean, .. } = event {
//!         println!("{split}: {:.2} dB", mean.psnr_scene);
//!     }
//! };
//! let launch = Launch { folder: &folder, observer: &observer, stop: &StopFlag::new() };
//! let mut trained = run::fresh(config, engine, launch, |_| folder.lock())?;
//!
//! assert_eq!(trained.outcome, Outcome::Finished);
//! assert!(folder.report().is_file() && folder.scene(5).is_file());
//! assert_eq!(run::open_scene(&my_run, &Silent)?, trained.scene()?);
//! # Ok(())
//! # }
//! ```

mod cameras;
mod captures;
pub(crate) mod checkpoints;
pub(crate) mod clock;
mod config;
mod evaluate;
pub mod evaluation;
mod explicit;
mod folder;
mod follow;
mod inapplicable;
mod kept_renders;
mod launch;
pub mod log;
mod non_splat_kind;
mod plots;
mod ranks;
pub mod report;
mod session;
pub mod state;
mod supervision;
pub(crate) mod test_curve;
mod time_budget;

pub use cameras::RunCameras;
pub use captures::{Captures, vignetting_text};
pub use config::{Difference, MadeBy, RunConfig, RunOptions};
pub use evaluate::{EvaluationData, MetricsOptions, SceneMetrics, evaluate_run, evaluate_scene};
pub use evaluation::{Metrics, Rendering};
pub use explicit::ExplicitArgs;
pub use folder::{LOCK, PathContents, RunFolder, RunLock, is_left_over};
pub use follow::follow;
pub use inapplicable::{Choice, Inapplicable};
pub use launch::{Launch, TrainedRun, fresh, fresh_over, resume, resume_over};
pub use non_splat_kind::NonSplatKind;
pub use plots::PlotLog;
pub use session::{EXIT_INTERRUPTED, Outcome, Session};
pub use state::open_scene;
pub use time_budget::TimeLimit;
