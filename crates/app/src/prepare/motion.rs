//! Poses of the views, and the data set that they make.
//!
//! In: the proxies of developed views, and COLMAP if it is installed. Out: [`Poses`], and the data
//! set once poses are known. Degenerate: without COLMAP its commands are written as a script, and a
//! model that the user made with them is taken over.

use std::collections::BTreeMap;

use luxel::{Error, Observer, Remedy, Result};
use luxel_capture::prepare::{Plan, Registration, SetProjection, ViewRecord};

use super::PrepareOptions;
use super::colmap::{self, Colmap};
use super::dataset::{self, Pixels};
use super::develop::Developer;
use super::markers;
use super::options::{Features, Mapper, MotionOptions};
use super::panoramas::{PanoramaModel, panorama_model};
use super::pictures::Pictures;
use super::state::{State, key};
use super::world::{self, FileFacts, WorldReport};
use crate::files::write_text;

/// Poses of the views and their origin.
pub(super) struct Poses {
    /// `None` until structure from motion was run.
    pub(super) registration: Option<Registration>,
    /// How the poses were found, in words for people.
    pub(super) origin: String,
    /// The data set's coordinates.
    pub(super) world: Option<WorldReport>,
}

/// A data set that was written.
struct Assembled {
    registration: Registration,
    world: Option<WorldReport>,
}

/// Structure from motion of a set.
pub(super) struct Motion<'a> {
    pub(super) options: &'a PrepareOptions,
    /// COLMAP, if it is installed and to be used.
    pub(super) installed: Option<&'a Colmap>,
    pub(super) developer: &'a Developer<'a>,
}

impl Motion<'_> {
    /// Refuses choices that the installed COLMAP lacks.
    pub(super) fn check(&self) -> Result<()> {
        let usual = PrepareOptions::new("", "");
        if self.is_panorama() && self.options.camera_model != usual.camera_model {
            let message = "panoramas have no lens to fit: a camera model is for other photographs";
            return Err(Error::new(message).with_remedy(Remedy::leave_out("camera_model")));
        }
        markers::check(self.options, self.is_panorama())?;
        let projection = self.developer.plan.projection;
        self.installed.map_or(Ok(()), |colmap| colmap.check(self.motion_options(), self.options.matching, projection))
    }

    /// Finds poses and writes the data set, or writes COLMAP's commands where there is none.
    pub(super) fn run(&self, records: &[ViewRecord], state: &mut State, observer: &dyn Observer) -> Result<Poses> {
        match self.installed {
            Some(colmap) => self.run_colmap(colmap, records, state, observer),
            None => self.write_commands(records, state, observer),
        }
    }

    /// Returns the settings that poses depend on, for keys.
    pub(super) fn settings(&self) -> String {
        let PrepareOptions { camera_model, matching, features, mapper, .. } = self.options;
        let panoramas = if self.is_panorama() { " panoramas" } else { "" };
        format!("{camera_model:?} {matching:?} {features:?} {mapper:?} {:?}{panoramas}", self.installed.map(|c| &c.version))
    }

    fn run_colmap(&self, colmap: &Colmap, records: &[ViewRecord], state: &mut State, observer: &dyn Observer) -> Result<Poses> {
        let folders = self.developer.folders;
        let pictures = self.picture_keys(records);
        // A model that the user made with the written commands is not made anew.
        let is_given = state.sfm_key.is_none() && !state.pictures.is_empty() && state.pictures == pictures;
        if is_given && colmap::largest_model(folders).is_ok() {
            return self.assemble_given(records, observer);
        }
        let pairing = colmap.pairing(records, &self.facts(), self.options.matching, self.developer.plan.projection)?;
        let settings = self.settings();
        let sfm_key = key(records.iter().map(|r| r.key.as_str()).chain([settings.as_str()]));
        if state.sfm_key.as_ref() != Some(&sfm_key) || !folders.work.join("sparse").is_dir() {
            state.sfm_key = None;
            // From here on work/sparse holds a model of this function.
            state.pictures.clear();
            state.save()?;
            let steps = colmap.steps(folders, &self.pictures(records), self.motion_options(), &pairing)?;
            observer.note(&format!("{}: {}", colmap.version, pairing.words()));
            colmap.run(&steps, folders, observer)?;
            state.sfm_key = Some(sfm_key);
            state.pictures = pictures;
            state.save()?;
        }
        let Assembled { registration, world } = self.assemble(records, observer)?;
        let features = match self.options.features {
            Features::Sift => "SIFT features",
            Features::Aliked => "ALIKED features matched by LightGlue",
        };
        let mapper = match self.options.mapper {
            Mapper::Incremental => "incremental mapper",
            Mapper::Global => "global mapper",
        };
        let lens = match (self.is_panorama(), colmap.abilities.rigs) {
            (false, _) => format!("lens model {}", self.options.camera_model.name()),
            (true, true) => "six cut-outs of each panorama as a rig".to_owned(),
            (true, false) => "six cut-outs of each panorama, whose poses are averaged".to_owned(),
        };
        let origin = format!("{}, {features}, {}, {mapper}, {lens}", colmap.version, pairing.words());
        Ok(Poses { registration: Some(registration), origin, world })
    }

    fn write_commands(&self, records: &[ViewRecord], state: &mut State, observer: &dyn Observer) -> Result<Poses> {
        let folders = self.developer.folders;
        let pictures = self.picture_keys(records);
        let colmap = Colmap::unknown(&self.options.colmap);
        let pairing = colmap.pairing(records, &self.facts(), self.options.matching, self.developer.plan.projection)?;
        let steps = colmap.steps(folders, &self.pictures(records), self.motion_options(), &pairing)?;
        let path = folders.output.join("colmap.sh");
        write_text(&path, &colmap.script(&steps, folders))?;
        let given = folders.work.join("sparse");
        // Views that were added or removed since leave the poses of the others as they are.
        let is_outdated = pictures.iter().any(|(view, key)| state.pictures.get(view).is_some_and(|known| known != key));
        if given.is_dir() && is_outdated {
            let aside = colmap::set_aside(&given)?;
            observer.warn(&format!(
                "the model in {} is of other pictures than proxies/ has now; it was moved to {}",
                given.display(),
                aside.display()
            ));
        }
        if !given.is_dir() {
            state.pictures.clear();
        }
        state.pictures.extend(pictures);
        state.save()?;
        if !given.is_dir() {
            let origin = format!("none yet: run the commands in {}, then prepare the folder again", path.display());
            return Ok(Poses { registration: None, origin, world: None });
        }
        self.assemble_given(records, observer)
    }

    /// Writes the data set by a model that the user had COLMAP make.
    fn assemble_given(&self, records: &[ViewRecord], observer: &dyn Observer) -> Result<Poses> {
        let Assembled { registration, world } = self.assemble(records, observer)?;
        let origin = format!("the model that was found in {}", self.developer.folders.work.join("sparse").display());
        Ok(Poses { registration: Some(registration), origin, world })
    }

    fn assemble(&self, records: &[ViewRecord], observer: &dyn Observer) -> Result<Assembled> {
        let Developer { folders, plan, space, .. } = *self.developer;
        let mut model = colmap::largest_model(folders)?;
        if self.is_panorama() {
            let PanoramaModel { model: panoramas, note } = panorama_model(folders, records, &model.model)?;
            model.model = panoramas;
            note.iter().for_each(|note| observer.warn(note));
        }
        let world = world::place(&mut model.model, records, &self.facts(), folders, self.options)?;
        let registration = dataset::write(folders, records, &model, Pixels { space, is_absolute: plan.is_absolute }, observer)?;
        Ok(Assembled { registration, world })
    }

    fn facts(&self) -> FileFacts<'_> {
        FileFacts::new(self.developer.plan, self.developer.photos)
    }

    fn is_panorama(&self) -> bool {
        self.developer.plan.projection == SetProjection::Equirectangular
    }

    fn pictures(&self, records: &[ViewRecord]) -> Pictures {
        let Plan { cameras, projection, .. } = self.developer.plan;
        Pictures::new(records, cameras, self.options.camera_model, *projection)
    }

    fn motion_options(&self) -> MotionOptions {
        let &PrepareOptions { features, mapper, .. } = self.options;
        MotionOptions { features, mapper }
    }

    /// Returns the keys of the pictures that structure from motion gets, by view.
    fn picture_keys(&self, records: &[ViewRecord]) -> BTreeMap<String, String> {
        let by_name: BTreeMap<&str, &ViewRecord> = records.iter().map(|record| (record.name.as_str(), record)).collect();
        let made = self.developer.plan.views.iter().filter_map(|view| Some((view, *by_name.get(view.name.as_str())?)));
        made.map(|(view, record)| (view.name.clone(), self.developer.picture_key(view, record))).collect()
    }
}
