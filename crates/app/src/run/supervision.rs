//! The kind of images that a run reads, as its method trains on them.
//!
//! In: a configuration. Out: the kind that the method implies; an error where another is given.

use luxel::{Error, Remedy, Result};
use luxel_io::{Exposures, Supervision};
use luxel_train::{ColorValues, Scheme};

use super::{ExplicitArgs, RunConfig};

impl RunConfig {
    /// Reads the kind of images that the method trains on if it has a choice of one, unless the
    /// kind is explicit.
    pub fn imply_supervision(&mut self, explicit: &ExplicitArgs) {
        if let Some(supervision) = supervision_of(self.train.method.spec().scheme).filter(|_| !explicit.contains("supervision")) {
            self.load.supervision = supervision;
        }
    }

    /// Reads the middle exposure of each pose if the method sees one exposure and none is chosen:
    /// for tables, whose other methods read all.
    pub(crate) fn imply_exposure(&mut self) {
        if self.train.method.spec().values == ColorValues::Captured && self.load.exposures == Exposures::All {
            self.load.exposures = Exposures::Middle;
        }
    }

    /// Checks that the kind of images is the one that the method trains on.
    pub(super) fn check_supervision(&self) -> Result<()> {
        let (method, found) = (self.method_name(), self.load.supervision);
        let scheme = self.train.method.spec().scheme;
        let (images, name) = match supervision_of(scheme) {
            Some(wanted) if wanted == found => return Ok(()),
            None if scheme == Scheme::Radiance && found == Supervision::Ldr => {
                let message = format!("supervision: method {method} learns from radiance, not from captured LDR images");
                return Err(Error::new(message).with_remedy(Remedy::set("supervision", "hdr").or(Remedy::set("method", "hdr-nerf-grid"))));
            }
            None if found != Supervision::Both => return Ok(()),
            None => {
                let message = format!("supervision: found both, method {method} trains on one kind of images");
                return Err(Error::new(message).with_remedy(Remedy::set("supervision", "hdr").or(Remedy::set("method", "hdr-gs"))));
            }
            Some(Supervision::Both) => ("captured images beside radiance", "both"),
            Some(_) => ("captured images alone", "ldr"),
        };
        let message = format!("supervision: method {method} trains on {images}, expected {name}");
        Err(Error::new(message).with_remedy(Remedy::set("supervision", name).or(Remedy::leave_out("supervision"))))
    }
}

/// Returns the one kind of images that methods of a scheme imply; `None` if they train on radiance,
/// or on either.
fn supervision_of(scheme: Scheme) -> Option<Supervision> {
    match scheme {
        Scheme::Pairs => Some(Supervision::Both),
        Scheme::Captured => Some(Supervision::Ldr),
        Scheme::Radiance | Scheme::RadianceOrCaptured => None,
    }
}
