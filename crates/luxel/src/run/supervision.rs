//! The kind of images that a run reads, as its method trains on them.
//!
//! In: a configuration. Out: the kind that the method implies; an error where another is given.

use luxel_io::{Exposures, Supervision};
use luxel_train::Method;

use super::{ExplicitArgs, RunConfig};
use crate::{Error, Remedy, Result};

impl RunConfig {
    /// Reads the kind of images that the method needs, if it needs one that is not the default,
    /// unless the kind of images is explicit.
    pub fn imply_supervision(&mut self, explicit: &ExplicitArgs) {
        if explicit.contains("supervision") {
            return;
        }
        if self.train.method.trains_on_pairs() {
            self.load.supervision = Supervision::Both;
        } else if self.train.method == Method::HdrNerfGrid {
            self.load.supervision = Supervision::Ldr;
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
        let (method, found) = (self.method_name(), self.load.supervision);
        match self.train.method {
            of_pairs if of_pairs.trains_on_pairs() && found != Supervision::Both => {
                let message = format!("supervision: method {method} trains on captured images beside radiance, expected both");
                Err(Error::new(message).with_remedy(Remedy::set("supervision", "both").or(Remedy::leave_out("supervision"))))
            }
            of_pairs if of_pairs.trains_on_pairs() => Ok(()),
            Method::HdrNerfGrid if found != Supervision::Ldr => {
                let message = format!("supervision: method {method} trains on captured images alone, expected ldr");
                Err(Error::new(message).with_remedy(Remedy::set("supervision", "ldr").or(Remedy::leave_out("supervision"))))
            }
            Method::NerfGrid if found == Supervision::Ldr => {
                let message = format!("supervision: method {method} learns from radiance, not from captured LDR images");
                Err(Error::new(message).with_remedy(Remedy::set("supervision", "hdr").or(Remedy::set("method", "hdr-nerf-grid"))))
            }
            _ if found == Supervision::Both => {
                let message = format!("supervision: found both, method {method} trains on one kind of images");
                Err(Error::new(message).with_remedy(Remedy::set("supervision", "hdr").or(Remedy::set("method", "hdr-gs"))))
            }
            _ => Ok(()),
        }
    }
}
