//! Stands in for `ocio` in a build without the feature `ocio`: no configuration can be
//! opened.

use std::path::Path;

use luxel_core::{ColorSpace, Image};

use crate::IoError;
use crate::image::DisplayEncoding;

/// A colour space of an OpenColorIO configuration; this build has none.
#[derive(Debug)]
pub enum OcioSpace {}

impl OcioSpace {
    /// Refuses every configuration.
    ///
    /// # Errors
    /// Always: the feature is missing.
    pub fn open(config: &Path, _space: &str) -> Result<Self, IoError> {
        Err(IoError::unsupported(config, "this build has no OpenColorIO; build with the feature \"ocio\""))
    }

    /// Never called: there is no value of this type.
    pub fn digest(&self) -> &str {
        match *self {}
    }

    /// Never called: there is no value of this type.
    ///
    /// # Errors
    /// None.
    pub fn convert(&self, _image: &mut Image, _space: ColorSpace) -> Result<(), IoError> {
        match *self {}
    }
}

/// A display of an OpenColorIO configuration; this build has none.
#[derive(Debug)]
pub enum OcioDisplay {}

impl OcioDisplay {
    /// Refuses every configuration.
    ///
    /// # Errors
    /// Always: the feature is missing.
    pub fn open(config: &Path, _display: Option<&str>, _view: Option<&str>) -> Result<Self, IoError> {
        OcioSpace::open(config, "").map(|space| match space {})
    }

    /// Never called: there is no value of this type.
    pub fn display(&self) -> &str {
        match *self {}
    }

    /// Never called: there is no value of this type.
    pub fn encoding(&self) -> Option<DisplayEncoding> {
        match *self {}
    }

    /// Never called: there is no value of this type.
    pub fn view(&self) -> &str {
        match *self {}
    }

    /// Never called: there is no value of this type.
    pub fn digest(&self) -> &str {
        match *self {}
    }

    /// Never called: there is no value of this type.
    ///
    /// # Errors
    /// None.
    pub fn encode(&self, _image: &mut Image, _space: ColorSpace) -> Result<(), IoError> {
        match *self {}
    }
}
