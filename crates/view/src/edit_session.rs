//! The tools for edits in the page, besides pictures: splats that masks and floaters name, how many
//! a selection has, its overlay, and the edited scene as a file.
//!
//! In: stacks of edits in their text form; out: numbers, pictures, files. Work runs on an engine of
//! its own, so that pictures of the scene wait for none of it. Masks are files in the folder of
//! edits, [`SUBFOLDER`]; no other file is read. What was found once about masks and floaters is
//! kept: both are of the scene as it is before the edits.

use std::collections::VecDeque;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};

use bytes::Bytes;
use luxel::edit::{self, Overlay, Removed, StackInputs, Watching};
use luxel::{Device, Error, Result, Scene, SelectedEngine, Silent};
use luxel_core::edit::{EditStack, MaskName, MaskShares, SelectionSummary, ShMap};
use luxel_core::{Camera, Edit, Engine, Mask, OnDemand, Selection};

use crate::changes::pack_changes;
use crate::folder::{Folder, check_name};
use crate::subject::Subject;

/// The subfolder of saved edits, masks and scenes.
pub(crate) const SUBFOLDER: &str = "edits";
/// Extension of a file of edits.
pub(crate) const EXTENSION: &str = "edits";
/// Saved stacks that are listed.
const MAX_LISTED: usize = 500;
/// Masks whose splats are kept.
const MAX_KEPT_MASKS: usize = 64;
/// Painted masks that no saved edits name which are kept as files; the oldest is removed.
const MAX_UNSAVED_MASKS: usize = 100;
/// Numbers that are tried for the name of a mask.
const MASK_NUMBERS: std::ops::Range<u32> = 1..100_000;

/// A camera of the data set, which tells what is seen.
struct SelectionCamera {
    name: String,
    camera: Camera,
    mask: Option<OnDemand<Mask>>,
}

/// The tools for edits of one scene.
pub(crate) struct EditSession {
    scene: Arc<Scene>,
    cameras: Vec<SelectionCamera>,
    folder: Option<Folder>,
    /// The folder as the user named it.
    given: PathBuf,
    background: [f32; 3],
    engine: Mutex<Option<Box<dyn Engine>>>,
    masks: Mutex<MaskShares>,
    floaters: Mutex<Option<Removed>>,
    /// Masks that were painted since the start and belong to no saved edits, oldest first.
    painted: Mutex<VecDeque<String>>,
}

/// The splats that a request asks about.
pub(crate) struct Question {
    /// Edits before the selection.
    pub(crate) before: EditStack,
    /// The selection; `None` for floaters.
    pub(crate) selection: Option<Selection>,
}

/// Selected splats, with their numbers.
pub(crate) struct Selected {
    /// Weight of each, `[N]`.
    pub(crate) weights: Vec<f32>,
    /// Count, light, bounds.
    pub(crate) summary: SelectionSummary,
}

fn lock<T>(mutex: &Mutex<T>) -> std::sync::MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl EditSession {
    /// Returns the tools for the subject's scene, before a background in normalised units.
    pub(crate) fn new(subject: &Subject, scene: Arc<Scene>, background: [f32; 3]) -> Self {
        let camera =
            |view: &crate::subject::Shown| SelectionCamera { name: view.name.clone(), camera: view.camera(), mask: view.mask.clone() };
        Self {
            scene,
            cameras: subject.views.iter().map(camera).collect(),
            folder: subject.folder.clone(),
            given: subject.given_folder.clone(),
            background,
            engine: Mutex::new(None),
            masks: Mutex::default(),
            floaters: Mutex::new(None),
            painted: Mutex::default(),
        }
    }

    /// Returns the scene as it was opened.
    pub(crate) fn scene(&self) -> &Scene {
        &self.scene
    }

    /// Returns the folder of edits as a command names it.
    pub(crate) fn place(&self) -> PathBuf {
        self.given.join(SUBFOLDER)
    }

    /// Returns where new files are made.
    pub(crate) fn folder(&self) -> Result<&Folder> {
        self.folder.as_ref().ok_or_else(|| Error::new("this viewer has no folder to save into"))
    }

    fn with_engine<T>(&self, work: impl FnOnce(&mut dyn Engine) -> Result<T>) -> Result<T> {
        let mut engine = lock(&self.engine);
        if engine.is_none() {
            *engine = Some(SelectedEngine::open(&Device::Cpu.into())?.engine);
        }
        let engine = engine.as_mut().ok_or_else(|| Error::new("no engine"))?;
        work(engine.as_mut())
    }

    /// Parses a stack whose masks are files of this place.
    ///
    /// # Errors
    /// A syntax error, or a mask that is elsewhere.
    pub(crate) fn parse(&self, text: &str) -> Result<EditStack> {
        let mut stack: EditStack = text.parse().map_err(|error: luxel_core::edit::EditTextError| Error::new(error.to_string()))?;
        let mut wrong = None;
        stack.each_mask(&mut |name| wrong = wrong.take().or(self.check_mask(name).err()));
        wrong.map_or(Ok(stack), Err)
    }

    /// Parses the text of a file of edits from anywhere, whose masks are taken to be in this place.
    ///
    /// # Errors
    /// A text that is no stack or an empty one, or a mask that is not here.
    pub(crate) fn parse_file(&self, text: &str) -> Result<EditStack> {
        let mut stack: EditStack = text.parse().map_err(|error: luxel_core::edit::EditTextError| Error::new(error.to_string()))?;
        if stack.is_empty() {
            return Err(Error::new("has no edits"));
        }
        let place = self.place();
        let here = |name: &str| match Path::new(name).parent() == Some(&place) {
            true => name.to_owned(),
            false => place.join(name).display().to_string(),
        };
        stack.each_mask(&mut |name| {
            name.file = here(&name.file);
            if !edit::needs_dataset(name) {
                name.view = here(&name.view);
            }
        });
        self.parse(&stack.to_string())
    }

    /// Parses a selection whose masks are files of this place.
    ///
    /// # Errors
    /// A syntax error, or a mask that is elsewhere.
    pub(crate) fn parse_selection(&self, text: &str) -> Result<Selection> {
        let mut selection: Selection = text.parse().map_err(|error: luxel_core::edit::EditTextError| Error::new(error.to_string()))?;
        let mut wrong = None;
        selection.each_mask(&mut |name| wrong = wrong.take().or(self.check_mask(name).err()));
        wrong.map_or(Ok(selection), Err)
    }

    /// Checks that a mask, and its camera if that is a file, are in the folder of edits.
    fn check_mask(&self, name: &MaskName) -> Result<()> {
        let folder = self.folder().map_err(|_| Error::new("this viewer has no folder in which painted masks are looked for"))?;
        let folder = folder.path().join(SUBFOLDER);
        let check = |file: &str| {
            let path = Path::new(file);
            let own = path.file_name().and_then(|own| own.to_str()).unwrap_or_default();
            if path.parent() != Some(&self.place()) || check_name(own).is_err() {
                let place = self.place();
                return Err(Error::new(format!(
                    "the mask \"{}\" is not in {}, expected one of there",
                    file.escape_default(),
                    place.display()
                )));
            }
            let real = std::fs::canonicalize(folder.join(own)).map_err(|error| Error::new(format!("{file}: cannot read: {error}")))?;
            match real == folder.join(own) {
                true => Ok(()),
                false => Err(Error::new(format!("{file}: is a link, expected a file"))),
            }
        };
        check(&name.file)?;
        if edit::needs_dataset(name) { self.camera(&name.view).map(|_| ()) } else { check(&name.view) }
    }

    /// Returns the camera of a view.
    fn camera(&self, name: &str) -> Result<Camera> {
        let named = |camera: &&SelectionCamera| camera.name == name || camera.name.rsplit('/').next() == Some(name);
        let mut found = self.cameras.iter().filter(named);
        match (found.next(), found.next()) {
            (Some(camera), None) => Ok(camera.camera.clone()),
            (Some(_), Some(_)) => Err(Error::new(format!("several views are called \"{}\", give the folder too", name.escape_default()))),
            (None, _) => Err(Error::new(format!("no view \"{}\" for a mask", name.escape_default()))),
        }
    }

    /// Returns the shares of masks.
    fn shares(&self, names: &[&MaskName]) -> Result<MaskShares> {
        if names.is_empty() {
            return Ok(MaskShares::new());
        }
        let missing: Vec<&MaskName> = {
            let kept = lock(&self.masks);
            names.iter().copied().filter(|name| !kept.contains_key(name)).collect()
        };
        let found = self.with_engine(|engine| edit::project_masks(&missing, &self.scene, &|name| self.camera(name), engine))?;
        let mut kept = lock(&self.masks);
        if kept.len() + found.len() > MAX_KEPT_MASKS {
            kept.retain(|name, _| names.contains(&name));
        }
        kept.extend(found);
        Ok(names.iter().filter_map(|name| Some(((*name).clone(), kept.get(name)?.clone()))).collect())
    }

    /// Returns the floaters of the scene.
    pub(crate) fn floaters(&self) -> Result<Removed> {
        let mut kept = lock(&self.floaters);
        if let Some(found) = &*kept {
            return Ok(found.clone());
        }
        let views: Vec<Watching<'_>> =
            self.cameras.iter().map(|camera| Watching { camera: &camera.camera, mask: camera.mask.as_ref() }).collect();
        let views = Some(views.as_slice()).filter(|views| !views.is_empty());
        let found = self.with_engine(|engine| Removed::floaters_in(&self.scene, views, engine, &Silent))?;
        *kept = Some(found.clone());
        Ok(found)
    }

    /// Returns what a stack needs besides the scene.
    ///
    /// # Errors
    /// A mask that cannot be read or projected.
    pub(crate) fn inputs(&self, stack: &EditStack) -> Result<StackInputs> {
        let selecting = stack.selecting();
        let masks = self.shares(&edit::mask_names(&selecting))?;
        let mut removed = Removed { reasons: vec![None; self.scene.splats.len()] };
        if let Some(selection) = &stack.delete {
            removed = Removed::selected(selection, &self.scene, &masks)?;
        }
        if stack.floaters {
            removed = removed.or(self.floaters()?);
        }
        Ok(StackInputs { masks, removed })
    }

    /// Returns the scene under a stack.
    ///
    /// # Errors
    /// A stack that does not go with the scene.
    pub(crate) fn edited(&self, stack: &EditStack) -> Result<luxel_core::Scene> {
        let inputs = self.inputs(stack)?;
        let mut scene = Scene::clone(&self.scene).into_core();
        edit::apply_stack(stack, &mut scene, &inputs, ShMap::default(), &Silent)?;
        Ok(scene)
    }

    /// Returns the changes that a stack makes to what is seen of the scene, packed for a page that
    /// has its splats.
    ///
    /// # Errors
    /// A stack that does not go with the scene, or leaves nothing of it.
    pub(crate) fn changes(&self, stack: &EditStack) -> Result<Bytes> {
        let StackInputs { masks, removed } = self.inputs(stack)?;
        if removed.count() == self.scene.splats.len() && removed.count() > 0 {
            return Err(Error::new(format!("nothing would be left of {} splats; narrow the selection", removed.count())));
        }
        let mut scene = Scene::clone(&self.scene).into_core();
        edit::apply(&stack.edits, &mut scene, &masks, ShMap::default(), &Silent)?;
        Ok(pack_changes(&self.scene.splats, &scene.splats, |splat| removed.is_removed(splat)))
    }

    /// Returns the weights of selected splats of the scene after the edits before, with their
    /// numbers.
    ///
    /// # Errors
    /// A selection that does not go with the scene.
    pub(crate) fn selected(&self, question: &Question) -> Result<Selected> {
        let Some(selection) = &question.selection else {
            let floaters = self.floaters()?;
            let weights: Vec<f32> = (0..self.scene.splats.len()).map(|i| f32::from(u8::from(floaters.is_removed(i)))).collect();
            return Ok(Selected { summary: SelectionSummary::new(&self.scene, &weights), weights });
        };
        let asked = Edit { selection: selection.clone(), maps: Vec::new() };
        let masks: Vec<Edit> = question.before.edits.iter().cloned().chain([asked]).collect();
        let masks = self.shares(&edit::mask_names(&masks))?;
        let cannot = |error: &dyn std::fmt::Display| Error::new(error.to_string());
        let mut before = std::borrow::Cow::Borrowed(&**self.scene);
        for edit in &question.before.edits {
            edit.apply(before.to_mut(), &masks, ShMap::default()).map_err(|error| cannot(&error))?;
        }
        let weights = selection.weights(&before, &masks).map_err(|error| cannot(&error))?;
        Ok(Selected { summary: SelectionSummary::new(&before, &weights), weights })
    }

    /// Draws selected splats over a grey picture of the scene as it was opened, as `luxel edit
    /// --overlay` does. Returns the PNG.
    ///
    /// # Errors
    /// A camera that cannot be rendered.
    pub(crate) fn overlay(&self, weights: &[f32], camera: &Camera) -> Result<Vec<u8>> {
        luxel::memory::check_render(camera.size_px, self.scene.raster.samples)?;
        let overlay = Overlay { scene: &self.scene, weights, camera, background: self.background };
        self.with_engine(|engine| edit::overlay_png(overlay, engine))
    }

    /// Writes a painted mask and its camera as new files, and returns their common name.
    ///
    /// # Errors
    /// The file system's refusal.
    pub(crate) fn save_mask(&self, png: &[u8], camera_json: &str) -> Result<String> {
        let folder = self.folder()?;
        let mut painted = lock(&self.painted);
        let is_free = |number: &u32| !folder.path().join(SUBFOLDER).join(format!("mask-{number}.png")).exists();
        let number = MASK_NUMBERS.into_iter().find(is_free).ok_or_else(|| Error::new("too many masks in the folder of edits"))?;
        let name = format!("mask-{number}");
        folder.new_file(SUBFOLDER, &name, "json", camera_json.as_bytes())?;
        folder.new_file(SUBFOLDER, &name, "png", png)?;
        painted.push_back(name.clone());
        if painted.len() > MAX_UNSAVED_MASKS
            && let Some(oldest) = painted.pop_front()
        {
            for extension in ["png", "json"] {
                luxel_app::files::remove_if_there(&folder.path().join(SUBFOLDER).join(format!("{oldest}.{extension}")))?;
            }
        }
        Ok(name)
    }

    /// Notes that saved edits name these masks, so that they stay.
    fn keep_masks(&self, stack: &EditStack) {
        let mut painted = lock(&self.painted);
        stack.clone().each_mask(&mut |name| {
            let own = Path::new(&name.file).file_stem().and_then(|own| own.to_str());
            painted.retain(|painted| Some(painted.as_str()) != own);
        });
    }

    /// Writes a stack as a new file, and returns its path.
    ///
    /// # Errors
    /// A name that is not plain or taken; the file system's refusal.
    pub(crate) fn save_stack(&self, name: &str, stack: &EditStack) -> Result<PathBuf> {
        let text = edit::stack_file_text(stack, &self.place());
        self.folder()?.new_file(SUBFOLDER, name, EXTENSION, text.as_bytes())?;
        self.keep_masks(stack);
        Ok(self.place().join(format!("{}.{EXTENSION}", name.trim_end_matches(".edits"))))
    }

    /// Writes the scene under a stack as a new file, and returns its path.
    ///
    /// # Errors
    /// A name that is not plain or taken; a stack that does not go with the scene; the file
    /// system's refusal.
    pub(crate) fn save_scene(&self, name: &str, stack: &EditStack) -> Result<PathBuf> {
        let name = name.strip_suffix(".ply").unwrap_or(name);
        let path = self.place().join(format!("{name}.ply"));
        let scene = self.edited(stack)?;
        let bytes = luxel_io::encode_scene_ply(&path, &scene).map_err(|error| Error::new(error.to_string()))?;
        self.folder()?.new_file(SUBFOLDER, name, "ply", &bytes)?;
        self.keep_masks(stack);
        Ok(path)
    }

    /// Returns the names of saved stacks, sorted; at most [`MAX_LISTED`].
    pub(crate) fn saved(&self) -> Vec<String> {
        let Ok(folder) = self.folder() else { return Vec::new() };
        let Ok(entries) = std::fs::read_dir(folder.path().join(SUBFOLDER)) else { return Vec::new() };
        let name = |entry: std::fs::DirEntry| entry.file_name().to_str()?.strip_suffix(".edits").map(str::to_owned);
        let mut names: Vec<String> = entries.flatten().filter_map(name).filter(|name| check_name(name).is_ok()).take(MAX_LISTED).collect();
        names.sort();
        names
    }

    /// Reads a saved stack.
    ///
    /// # Errors
    /// A name that is not plain, a file that is no stack.
    pub(crate) fn open_stack(&self, name: &str) -> Result<EditStack> {
        check_name(name)?;
        let file = format!("{name}.{EXTENSION}");
        let real = self.folder()?.path().join(SUBFOLDER).join(&file);
        if !std::fs::symlink_metadata(&real).is_ok_and(|found| found.is_file()) {
            return Err(Error::new(format!("{}: no such file of edits", self.place().join(&file).display())));
        }
        let stack = edit::read_stack(&self.place().join(&file))?;
        self.parse(&stack.to_string())
    }
}
