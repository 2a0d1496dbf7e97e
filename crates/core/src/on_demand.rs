//! Values that are in memory, or are read whenever they are needed: images and masks of views,
//! which may be larger together than memory.
//!
//! In: a value, or a [`Source`] that can read it. Out: the value. [`OnDemand::loaded`] reads it for
//! as long as the caller keeps the result; code that goes through many views uses it. Dereferencing
//! is for one value: it reads, too, and keeps what it read as long as `self` lives. Degenerate: a
//! value that cannot be read is an error of `loaded`; dereferenced, it is a stand-in of the same
//! size that is not a number, so that nothing computed from it passes for a result.

use std::fmt;
use std::ops::Deref;
use std::sync::{Arc, OnceLock, Weak};

use crate::{Image, Mask, Remedy};

/// Explains why a value could not be read again.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("{message}")]
pub struct ReadError {
    /// File, place, expected and found.
    pub message: String,
    /// The remedy, where one is known.
    pub remedy: Option<Remedy>,
}

/// Makes a value anew.
pub type Make<T> = dyn Fn() -> Result<T, ReadError> + Send + Sync;

/// Reads a value again and again, such as an image from a file.
pub trait Source<T>: fmt::Debug + Send + Sync {
    /// Reads the value, which is the same every time.
    ///
    /// # Errors
    /// A file that is gone, damaged or changed.
    fn read(&self) -> Result<T, ReadError>;

    /// Returns a value that is made from this one and stored beside it under `label`, so that it is
    /// made once; `size` is its width and height. `None` from a source that stores nothing.
    fn derived(&self, _label: &str, _size: [usize; 2], _make: Arc<Make<T>>) -> Option<OnDemand<T>> {
        None
    }

    /// Returns a value of the same size for where an error cannot be reported: all NaN.
    fn stand_in(&self) -> T;
}

/// A value in memory, or one that is read when it is needed.
///
/// ```
/// use luxel_core::{Image, OnDemand};
///
/// let image: OnDemand<Image> = Image::filled(4, 3, [1.0; 3]).into();
/// assert!(image.is_in_memory());
/// assert_eq!((image.width, image.loaded()?.height), (4, 3));
/// # Ok::<(), luxel_core::ReadError>(())
/// ```
pub struct OnDemand<T>(Held<T>);

enum Held<T> {
    Value(Arc<T>),
    /// A source, and the value where it has been read.
    Source(Arc<dyn Source<T>>, OnceLock<Arc<T>>),
}

impl<T> OnDemand<T> {
    /// Returns a value that is read through `source`.
    pub fn from_source(source: Arc<dyn Source<T>>) -> Self {
        Self(Held::Source(source, OnceLock::new()))
    }

    /// Returns the value if it is in memory.
    pub fn get(&self) -> Option<&Arc<T>> {
        match &self.0 {
            Held::Value(value) => Some(value),
            Held::Source(_, value) => value.get(),
        }
    }

    /// Returns whether the value is in memory.
    pub fn is_in_memory(&self) -> bool {
        self.get().is_some()
    }

    /// Returns the source that the value is read from, unless it was made in memory.
    pub fn source(&self) -> Option<&Arc<dyn Source<T>>> {
        match &self.0 {
            Held::Value(_) => None,
            Held::Source(source, _) => Some(source),
        }
    }

    /// Returns the value in memory: itself where it is there already, else a copy that is dropped
    /// with the result.
    ///
    /// # Errors
    /// A value that cannot be read.
    pub fn loaded(&self) -> Result<Self, ReadError> {
        match &self.0 {
            Held::Source(source, value) if value.get().is_none() => {
                Ok(Self(Held::Source(Arc::clone(source), OnceLock::from(Arc::new(source.read()?)))))
            }
            _ => Ok(self.clone()),
        }
    }

    /// Returns the value without what was read of it, so that keeping it takes no memory; a value
    /// without a source stays.
    #[must_use]
    pub fn released(&self) -> Self {
        match &self.0 {
            Held::Value(_) => self.clone(),
            Held::Source(source, _) => Self::from_source(Arc::clone(source)),
        }
    }

    /// Returns the value, shared.
    pub fn shared(&self) -> Arc<T> {
        Arc::clone(self.force())
    }

    /// Returns what the value is recognised by as long as it, or its source, exists.
    pub fn identity(&self) -> Identity<T> {
        match &self.0 {
            Held::Value(value) => Identity::Value(Arc::downgrade(value)),
            Held::Source(source, _) => Identity::Source(Arc::downgrade(source)),
        }
    }

    fn force(&self) -> &Arc<T> {
        match &self.0 {
            Held::Value(value) => value,
            Held::Source(source, value) => value.get_or_init(|| Arc::new(source.read().unwrap_or_else(|_| source.stand_in()))),
        }
    }
}

impl<T: Clone> OnDemand<T> {
    /// Returns the value itself, without a copy where nothing else shares it.
    pub fn into_value(self) -> T {
        let value = self.shared();
        drop(self);
        Arc::unwrap_or_clone(value)
    }
}

impl<T> Deref for OnDemand<T> {
    type Target = T;

    fn deref(&self) -> &T {
        self.force()
    }
}

impl<T> Clone for OnDemand<T> {
    fn clone(&self) -> Self {
        Self(match &self.0 {
            Held::Value(value) => Held::Value(Arc::clone(value)),
            Held::Source(source, value) => Held::Source(Arc::clone(source), value.clone()),
        })
    }
}

impl<T> From<Arc<T>> for OnDemand<T> {
    fn from(value: Arc<T>) -> Self {
        Self(Held::Value(value))
    }
}

impl<T> From<T> for OnDemand<T> {
    fn from(value: T) -> Self {
        Arc::new(value).into()
    }
}

impl<T: PartialEq> PartialEq for OnDemand<T> {
    fn eq(&self, other: &Self) -> bool {
        **self == **other
    }
}

impl<T: fmt::Debug> fmt::Debug for OnDemand<T> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match &self.0 {
            Held::Value(value) => value.fmt(f),
            Held::Source(source, _) => source.fmt(f),
        }
    }
}

/// Recognises a value: by its allocation, or by the source that it is read from.
pub enum Identity<T> {
    /// A value in memory.
    Value(Weak<T>),
    /// A value that is read.
    Source(Weak<dyn Source<T>>),
}

impl<T> Identity<T> {
    /// Returns whether the value, or its source, still exists.
    pub fn is_alive(&self) -> bool {
        match self {
            Self::Value(value) => value.strong_count() > 0,
            Self::Source(source) => source.strong_count() > 0,
        }
    }

    /// Returns whether `value` is the one.
    pub fn is_of(&self, value: &OnDemand<T>) -> bool {
        match (self, &value.0) {
            (Self::Source(known), Held::Source(source, _)) => std::ptr::addr_eq(known.as_ptr(), Arc::as_ptr(source)),
            (Self::Value(known), Held::Value(value)) => std::ptr::eq(known.as_ptr(), Arc::as_ptr(value)),
            _ => false,
        }
    }
}

/// Returns an image of this size that is not a number anywhere.
pub fn unreadable_image(width: usize, height: usize) -> Image {
    Image::filled(width, height, [f32::NAN; 3])
}

/// Returns a mask of this many pixels none of which is valid.
pub fn unreadable_mask(pixels: usize) -> Mask {
    Mask { weights: vec![f32::NAN; pixels] }
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::{AtomicUsize, Ordering};

    use super::*;

    /// Reads the number of reads so far.
    #[derive(Debug)]
    struct Counter(AtomicUsize, bool);

    impl Source<usize> for Counter {
        fn read(&self) -> Result<usize, ReadError> {
            let reads = self.0.fetch_add(1, Ordering::Relaxed);
            if self.1 { Ok(reads) } else { Err(ReadError { message: "a.exr: gone".into(), remedy: None }) }
        }

        fn stand_in(&self) -> usize {
            usize::MAX
        }
    }

    #[test]
    fn a_value_is_read_each_time_and_kept_by_the_one_who_loaded_it() {
        let value = OnDemand::from_source(Arc::new(Counter(AtomicUsize::new(0), true)));
        let (first, second) = (value.loaded().unwrap(), value.loaded().unwrap());
        assert_eq!((*first, *second, *first.loaded().unwrap(), *first.clone()), (0, 1, 0, 0));
        assert!(!value.is_in_memory() && first.is_in_memory());
        assert!(first.identity().is_of(&second) && value.identity().is_alive());
        let identity = value.identity();
        drop((value, first, second));
        assert!(!identity.is_alive());
    }

    #[test]
    fn values_in_memory_are_told_apart_by_their_allocation() {
        let (a, b) = (OnDemand::from(7), OnDemand::from(7));
        assert!(a == b && a.identity().is_of(&a.clone()) && !a.identity().is_of(&b));
        assert_eq!(a.into_value(), 7);
    }

    #[test]
    fn what_cannot_be_read_is_an_error_or_no_number() {
        let value = OnDemand::from_source(Arc::new(Counter(AtomicUsize::new(0), false)));
        assert_eq!(value.loaded().unwrap_err().to_string(), "a.exr: gone");
        assert_eq!(*value, usize::MAX);
        assert!(unreadable_image(2, 1).pixels.as_flattened().iter().all(|v| v.is_nan()));
        assert!(!unreadable_mask(1).is_valid(0) && unreadable_mask(1).total().is_none());
    }
}
