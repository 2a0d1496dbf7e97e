//! The thread that owns the engine and answers jobs: a scene as it is, or under edits.
//!
//! In: a scene, its renderer, and jobs; out: pictures. The last picture is kept, so that a probe of
//! a picture that was just shown costs nothing. An engine without coverage and depth gives pictures
//! without them.

use std::sync::Arc;
use std::time::Instant;

use crate::solids::{self, SolidOptions};
use luxel::{Error, Radiance, RadianceLayers, Renderer, Result, Scene};
use luxel_core::edit::EditStack;

use crate::edit_session::EditSession;
use crate::jobs::{Job, Loaded, PictureJob, Rendered, Reply, Stage, Wanted};
use crate::lens::LensRequest;

/// The picture that was rendered last.
#[derive(Default)]
pub(crate) struct LastPicture(Option<(Wanted, Rendered)>);

impl LastPicture {
    /// Answers a job, from the last picture if it is the same.
    pub(crate) fn answer(&mut self, job: Job, stage: &mut dyn Stage) {
        let PictureJob { wanted, reply, .. } = match job {
            Job::Picture(job) => *job,
            Job::Task(task) => return task.run(stage),
        };
        let answer = self.picture(wanted, stage).map_or_else(|error| Reply::Failed(format!("{error:#}")), Reply::Done);
        // A receiver that left needs no answer.
        let _ = reply.send(answer);
    }

    fn picture(&mut self, wanted: Wanted, stage: &mut dyn Stage) -> Result<Rendered> {
        let version = stage.version();
        if let Some((last, rendered)) = &self.0
            && last.camera == wanted.camera
            && last.edit == wanted.edit
            && last.variant == wanted.variant
            && last.lens == wanted.lens
            && (last.layers || !wanted.layers)
            && rendered.version == version
        {
            return Ok(Rendered { seconds: 0.0, ..rendered.clone() });
        }
        let start = Instant::now();
        let picture = Arc::new(stage.render(&wanted)?);
        let rendered = Rendered { picture, version, seconds: start.elapsed().as_secs_f64() };
        self.0 = Some((wanted, rendered.clone()));
        Ok(rendered)
    }
}

/// A scene that does not change.
pub(crate) struct SceneStage {
    scene: Arc<Scene>,
    renderer: Renderer,
    /// The scene under the edits of `loaded`.
    current: Arc<Scene>,
    /// The edits that `current` has.
    loaded: String,
    /// Whether the renderer has the whole of `current`.
    is_whole: bool,
    has_layers: bool,
    /// Finds what edits name besides the scene; `None` for scenes beside the first.
    session: Option<Arc<EditSession>>,
}

impl SceneStage {
    /// Returns the stage of a scene that `renderer` has loaded.
    pub(crate) fn new(scene: Arc<Scene>, renderer: Renderer) -> Self {
        Self { current: Arc::clone(&scene), scene, renderer, loaded: String::new(), is_whole: true, has_layers: true, session: None }
    }

    /// Lets edits name masks and floaters.
    pub(crate) fn with_edit_session(self, session: Arc<EditSession>) -> Self {
        Self { session: Some(session), ..self }
    }

    /// Makes the scene under these edits the current one.
    fn load(&mut self, edit: &str) -> Result<()> {
        if self.loaded == edit {
            return Ok(());
        }
        let mut current = Arc::clone(&self.scene);
        if !edit.is_empty() {
            // Cameras are of the world as it is.
            let stack: EditStack = edit.parse().map_err(|error: luxel_core::edit::EditTextError| Error::new(error.to_string()))?;
            let stack = EditStack { up: None, origin: None, ..stack };
            if let Some(session) = &self.session {
                current = Arc::new(Scene::from(session.edited(&stack)?));
            } else if stack.delete.is_none() && !stack.floaters {
                for edit in &stack.edits {
                    Arc::make_mut(&mut current).edit(edit)?;
                }
            } else {
                return Err(Error::new("splats of the other scene cannot be deleted here"));
            }
        }
        (self.current, self.is_whole) = (current, false);
        edit.clone_into(&mut self.loaded);
        Ok(())
    }

    /// Gives the renderer what is wanted of the current scene: all of it, or what is between the
    /// clip planes.
    fn upload(&mut self, wanted: &Wanted) -> Result<()> {
        let Some(clip) = wanted.variant.clip else { return self.upload_whole() };
        self.is_whole = false;
        self.renderer.replace_scene(&clip.apply(&self.current, &wanted.camera))
    }

    /// Gives the renderer all of the current scene.
    fn upload_whole(&mut self) -> Result<()> {
        if !self.is_whole {
            self.renderer.replace_scene(&self.current)?;
            self.is_whole = true;
        }
        Ok(())
    }

    /// Renders what the renderer has, through the lens if there is one.
    fn radiance(&mut self, wanted: &Wanted) -> Result<Radiance> {
        match wanted.lens {
            Some(lens) => self.photograph(wanted, lens),
            None => self.renderer.render(&wanted.camera),
        }
    }

    fn photograph(&mut self, wanted: &Wanted, lens: LensRequest) -> Result<Radiance> {
        let photograph = lens.photograph(&wanted.camera, self.current.world_from_local.scale());
        self.renderer.photograph_part(&photograph, lens.samples, lens.part)
    }

    /// Draws the current scene's splats as bodies.
    fn solids(&self, wanted: &Wanted, options: SolidOptions) -> Result<RadianceLayers> {
        match wanted.variant.clip {
            Some(clip) => solids::render(&clip.apply(&self.current, &wanted.camera), &wanted.camera, options),
            None => solids::render(&self.current, &wanted.camera, options),
        }
    }
}

/// The scenes of a viewer; jobs name one by its index.
pub(crate) struct SceneStages(pub(crate) Vec<SceneStage>);

impl Stage for SceneStages {
    fn render(&mut self, wanted: &Wanted) -> Result<RadianceLayers> {
        let stage = self.0.get_mut(wanted.variant.scene).ok_or_else(|| Error::new("no such scene"))?;
        stage.render(wanted)
    }

    /// Returns the first scene.
    fn loaded(&mut self, edit: &str) -> Result<Loaded<'_>> {
        self.0.first_mut().ok_or_else(|| Error::new("no scene"))?.loaded(edit)
    }

    fn version(&self) -> u64 {
        0
    }
}

impl Stage for SceneStage {
    fn render(&mut self, wanted: &Wanted) -> Result<RadianceLayers> {
        self.load(&wanted.edit)?;
        if let Some(options) = wanted.variant.solids {
            return self.solids(wanted, options);
        }
        self.upload(wanted)?;
        if wanted.layers && self.has_layers {
            match self.renderer.render_layers(&wanted.camera) {
                // Coverage and depth through a lens are those of its middle.
                Ok(layers) => match wanted.lens {
                    Some(lens) => return Ok(RadianceLayers { radiance: self.photograph(wanted, lens)?, ..layers }),
                    None => return Ok(layers),
                },
                // Either the engine has none, or the picture itself fails, which is found out now.
                Err(_) => {
                    let picture = without_layers(self.radiance(wanted)?);
                    self.has_layers = false;
                    return Ok(picture);
                }
            }
        }
        Ok(without_layers(self.radiance(wanted)?))
    }

    fn loaded(&mut self, edit: &str) -> Result<Loaded<'_>> {
        self.load(edit)?;
        self.upload_whole()?;
        Ok(Loaded { scene: &self.current, renderer: &mut self.renderer })
    }

    fn version(&self) -> u64 {
        0
    }
}

/// Returns a picture without coverage and depth.
pub(crate) fn without_layers(radiance: Radiance) -> RadianceLayers {
    RadianceLayers { radiance, alpha: Vec::new(), depth: Vec::new() }
}

/// Checks edits before they wait for the engine.
pub(crate) fn check_edits(session: Option<&EditSession>, text: &str) -> Result<(), String> {
    if text.is_empty() {
        return Ok(());
    }
    match session {
        Some(session) => session.parse(text).map(drop).map_err(|error| format!("{error:#}")),
        None => text.parse::<EditStack>().map(drop).map_err(|error| error.to_string()),
    }
}
