//! The published methods that this program has, and the error of one that it was built without.

use luxel_core::Engine;
#[cfg(feature = "methods")]
use luxel_methods::CapturedMethods;
#[cfg(not(feature = "methods"))]
use luxel_train::NoMethods;
use luxel_train::{Method, NamedChoice, StepMethods, TrainingMeans};

use crate::{Error, Remedy, Result};

/// Returns the methods on splats with steps of their own.
pub fn step_methods() -> &'static dyn StepMethods {
    #[cfg(feature = "methods")]
    return &CapturedMethods;
    #[cfg(not(feature = "methods"))]
    return &NoMethods;
}

/// Returns the means of a training of splats on an engine.
pub fn means_of(engine: Box<dyn Engine>) -> TrainingMeans<'static> {
    TrainingMeans { engine, methods: step_methods() }
}

/// Returns the error of something that a published method is needed for.
pub fn not_built(what: impl std::fmt::Display) -> Error {
    let message = format!("{what}: this program was built without the feature methods, which has the published methods");
    Error::new(message).with_remedy(Remedy::advice("build it with the feature methods"))
}

/// Refuses a method that this program was built without.
///
/// # Errors
/// Names the feature that has it.
pub fn check_is_built(method: Method) -> Result<()> {
    let is_published = method.has_own_steps() || !method.stores_splats();
    if is_published && !cfg!(feature = "methods") {
        return Err(not_built(method.name()));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_method_that_is_not_built_in_is_refused_with_the_name_of_its_feature() {
        assert!([Method::Lcd, Method::Sh3, Method::LogSh3].into_iter().all(|method| check_is_built(method).is_ok()));
        for method in [Method::NerfGrid, Method::LcdAnchors, Method::HdrGs, Method::GaussHdr] {
            let found = check_is_built(method);
            assert_eq!(found.is_ok(), cfg!(feature = "methods"), "{method:?}");
            assert!(found.map_or_else(|error| error.to_string().contains("without the feature methods"), |()| true));
        }
    }
}
