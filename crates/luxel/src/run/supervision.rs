//! The kind of images that a run reads, as its method trains on them.
//!
//! In: a configuration. Out: the kind that the method implies; an error where another is given.

use luxel_io::{Exposures, Supervision};

use super::{ExplicitArgs, RunConfig};
use crate::{Error, Remedy, Result};

impl RunConfig {
    /// Reads captured images beside radiance if the method trains on both, unless the kind of
    /// images is explicit.
    pub fn imply_supervision(&mut self, explicit: &ExplicitArgs) {
        if self.train.method.trains_on_pairs() && !explicit.contains("supervision") {
            self.load.supervision = Supervision::Both;
        }
    }

    /// Reads the middle exposure of each pose if the method sees one exposure and none is chosen:
    /// for tables, whose other methods read all.
    pub(crate) fn imply_exposure(&mut self) {
        if self.train.method.needs_one_exposure() && self.load.exposures == Exposures::All {
            self.load.exposures = Exposures::Middle;
        }
    }

    /// Checks that the kind of images is the one that the method trains on.
    pub(super) fn check_supervision(&self) -> Result<()> {
        let (method, is_pairs) = (self.method_name(), self.load.supervision == Supervision::Both);
        match self.train.method.trains_on_pairs() {
            true if !is_pairs => {
                let message = format!("supervision: method {method} trains on captured images beside radiance, expected both");
                Err(Error::new(message).with_remedy(Remedy::set("supervision", "both").or(Remedy::leave_out("supervision"))))
            }
            false if is_pairs => {
                let message = format!("supervision: found both, method {method} trains on one kind of images");
                Err(Error::new(message).with_remedy(Remedy::set("supervision", "hdr").or(Remedy::set("method", "hdr-gs"))))
            }
            _ => Ok(()),
        }
    }
}
