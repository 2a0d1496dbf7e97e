//! Structure from motion, and the data set that follows from it.

use std::collections::BTreeMap;

use luxel_capture::prepare::{Registration, ViewRecord};

use super::colmap::{self, Colmap};
use super::dataset;
use super::develop::Developer;
use super::folders::Folders;
use super::state::{State, key};
use super::{MotionOptions, PrepareOptions};
use crate::files::write_text;
use crate::{Observer, Result};

/// Returns what poses depend on besides the views.
pub(super) fn motion_key(options: &PrepareOptions, installed: Option<&Colmap>) -> String {
    format!("{:?} {:?} {:?}", options.camera_model, options.matching, installed.map(|c| &c.version))
}

/// Describes a model that the user made with the written commands.
fn given_model(folders: &Folders) -> String {
    format!("the model that was found in {}", folders.work.join("sparse").display())
}

/// From proxies to the data set.
pub(super) struct Motion<'a> {
    pub(super) options: &'a PrepareOptions,
    pub(super) developer: &'a Developer<'a>,
}

impl Motion<'_> {
    /// Poses and data set, and how they came about; `None` without COLMAP, where the commands are written instead.
    pub(super) fn run(
        &self,
        installed: Option<&Colmap>,
        records: &[ViewRecord],
        state: &mut State,
        observer: &dyn Observer,
    ) -> Result<(Option<Registration>, String)> {
        let options = MotionOptions { camera_model: self.options.camera_model, matching: self.options.matching };
        let Developer { folders, plan, .. } = *self.developer;
        let pictures = self.pictures(records);
        let Some(colmap) = installed else {
            let colmap = Colmap::unknown(&self.options.colmap);
            let steps = colmap.steps(folders, records, &plan.cameras, options)?;
            let path = folders.output.join("colmap.sh");
            write_text(&path, &colmap.script(&steps, folders))?;
            let given = folders.work.join("sparse");
            // Views that came or went since leave the poses of the others as they are.
            let is_of_others = pictures.iter().any(|(view, key)| state.pictures.get(view).is_some_and(|seen| seen != key));
            if given.is_dir() && is_of_others {
                let aside = colmap::set_aside(&given)?;
                observer.warn(&format!(
                    "the model in {} is of other pictures than proxies/ has now; it is in {}",
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
                return Ok((None, format!("none yet: the commands are in {}; run them, then luxel prepare again", path.display())));
            }
            let registration = self.assemble(records, observer)?;
            return Ok((Some(registration), given_model(folders)));
        };
        // What the user made by the commands that were written, without this command's doing: nothing to be made anew.
        let is_given = state.sfm_key.is_none() && !state.pictures.is_empty() && state.pictures == pictures;
        if is_given && colmap::largest_model(folders).is_ok() {
            let registration = self.assemble(records, observer)?;
            return Ok((Some(registration), given_model(folders)));
        }
        let keys = records.iter().map(|r| r.key.as_str());
        let wanted = motion_key(self.options, installed);
        let sfm_key = key(keys.chain([wanted.as_str()]));
        if state.sfm_key.as_ref() != Some(&sfm_key) || !folders.work.join("sparse").is_dir() {
            state.sfm_key = None;
            // From here on what is in work/sparse is this command's.
            state.pictures.clear();
            state.save()?;
            let steps = colmap.steps(folders, records, &plan.cameras, options)?;
            colmap.run(&steps, folders, records.len(), observer)?;
            state.sfm_key = Some(sfm_key);
            state.pictures = pictures;
            state.save()?;
        }
        let registration = self.assemble(records, observer)?;
        Ok((Some(registration), format!("{}, lens model {}", colmap.version, self.options.camera_model.name())))
    }

    fn assemble(&self, records: &[ViewRecord], observer: &dyn Observer) -> Result<Registration> {
        let Developer { folders, plan, space, .. } = *self.developer;
        let (model, models) = colmap::largest_model(folders)?;
        dataset::write(folders, records, (&model, models), (space, plan.is_absolute), observer)
    }

    /// Keys of the pictures that structure from motion gets, by view.
    fn pictures(&self, records: &[ViewRecord]) -> BTreeMap<String, String> {
        let by_name: BTreeMap<&str, &ViewRecord> = records.iter().map(|record| (record.name.as_str(), record)).collect();
        let made = self.developer.plan.views.iter().filter_map(|view| Some((view, *by_name.get(view.name.as_str())?)));
        made.map(|(view, record)| (view.name.clone(), self.developer.picture_key(view, record))).collect()
    }
}
