//! A run's folder that another program takes apart while the run is at work.

use luxel::error::Context;
use luxel::{Error, Result};
use luxel_core::Remedy;

use super::{LoopState, RunFolder, RunLog, Session, state};

impl Session<'_> {
    /// Ends a run whose folder is gone; nothing is made in its place.
    pub(super) fn check_exists(&self) -> Result<()> {
        if self.folder.root().is_dir() {
            return Ok(());
        }
        let (root, iteration) = (self.folder.root().display(), self.trainer.iteration());
        let message = format!("{root}: the folder was removed while the run was at work; it ends at step {iteration}, without a state");
        Err(Error::new(message).with_remedy(Remedy::advice("train again, into a folder that stays")))
    }

    /// Ends a run whose folder was taken apart meanwhile. The state is saved and the mark written
    /// again, so that the run can be resumed. Nothing is written where another process may be at
    /// work.
    pub(super) fn check_folder(&mut self, state: &mut LoopState) -> Result<()> {
        self.check_exists()?;
        let root = self.folder.root().display();
        let iteration = self.trainer.iteration();
        let has_lock = state.lock.is_none() || self.folder.lock_identity() == state.lock;
        let relocked = match has_lock {
            true => None,
            false => Some(self.folder.lock().with_context(|| {
                format!("{root}: its .lock was removed while the run was at work; it ends at step {iteration} and writes nothing more")
            })?),
        };
        let has_mark = RunFolder::is_run(self.folder.root());
        let removed = match (has_lock, has_mark) {
            (true, true) => return Ok(()),
            (false, true) => ".lock was removed",
            (true, false) => "config.toml was removed",
            (false, false) => "config.toml was removed, .lock was removed",
        };
        let message = format!("{root}: {removed} while the run was at work; the state of step {iteration} is saved");
        if !has_mark {
            self.folder.write_config(self.config)?;
        }
        self.log(state)?;
        self.save(state)?;
        drop(relocked);
        Err(Error::new(message).with_remedy(state::continue_run()))
    }

    /// Begins a new log if another program removed it meanwhile, and says so.
    pub(super) fn restore_log(&self, state: &mut LoopState) {
        if !self.folder.log().exists() {
            let opened = RunLog::open(&self.folder.log(), self.trainer.iteration(), &self.config.run.log).map(|(log, _)| state.log = log);
            self.report_log(opened, state);
            let root = self.folder.root().display();
            self.observer.warn(&format!("{root}: log.jsonl was removed while the run was at work; a new one begins here"));
        }
    }
}
