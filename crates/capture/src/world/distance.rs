//! A distance that the user knows.
//!
//! In: `A,B,METRES`. Out: [`KnownDistance`]. Each end is the name of a view, which stands for where
//! its camera is, or a point `x,y,z`.

use std::fmt;
use std::str::FromStr;

use glam::DVec3;

use super::WorldView;
use crate::prepare::PrepareError;

/// An end of a known distance.
#[derive(Clone, Debug, PartialEq)]
pub enum Landmark {
    /// The camera of a view, by its name or that of one of its files.
    View(String),
    /// A point.
    Point(DVec3),
}

impl fmt::Display for Landmark {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::View(name) => write!(f, "view {name}"),
            Self::Point(p) => write!(f, "point {},{},{}", p.x, p.y, p.z),
        }
    }
}

/// A distance between two places.
#[derive(Clone, Debug, PartialEq)]
pub struct KnownDistance {
    /// Both ends.
    pub ends: [Landmark; 2],
    /// Distance, metres.
    pub metres: f64,
}

/// The form, for messages.
const FORM: &str = "expected A,B,METRES, where A and B are names of views or points x,y,z";

impl FromStr for KnownDistance {
    type Err = String;

    /// Parses `A,B,METRES`.
    ///
    /// ```
    /// use luxel_capture::world::{KnownDistance, Landmark};
    ///
    /// let known: KnownDistance = "IMG_0001,IMG_0007,2.5".parse()?;
    /// assert_eq!(known.ends[1], Landmark::View("IMG_0007".into()));
    /// assert_eq!(known.metres, 2.5);
    /// # Ok::<(), String>(())
    /// ```
    fn from_str(text: &str) -> Result<Self, String> {
        let mut parts: Vec<&str> = text.split(',').map(str::trim).collect();
        let metres = parts.pop().and_then(|last| last.parse::<f64>().ok()).filter(|m| m.is_normal() && *m > 0.0);
        let metres = metres.ok_or_else(|| format!("{FORM}, and METRES a number above 0; got \"{text}\""))?;
        let point = |parts: &[&str]| {
            let numbers: Vec<f64> = parts.iter().filter_map(|part| part.parse().ok()).filter(|v: &f64| v.is_finite()).collect();
            <[f64; 3]>::try_from(numbers).ok().filter(|_| parts.len() == 3).map(|p| Landmark::Point(DVec3::from_array(p)))
        };
        let view = |name: &str| (!name.is_empty()).then(|| Landmark::View(name.to_owned()));
        let ends = match *parts.as_slice() {
            [a, b] => view(a).zip(view(b)),
            [x, .., last] if parts.len() == 4 => match (point(&parts[..3]).zip(view(last)), view(x).zip(point(&parts[1..]))) {
                (Some(_), Some(_)) => return Err(format!("\"{text}\": which of the four is a name? Add the extension of its file")),
                (one, other) => one.or(other),
            },
            _ if parts.len() == 6 => point(&parts[..3]).zip(point(&parts[3..])),
            _ => None,
        };
        let (a, b) = ends.ok_or_else(|| format!("{FORM}; got \"{text}\""))?;
        Ok(Self { ends: [a, b], metres })
    }
}

impl KnownDistance {
    /// Returns the metres in a unit of the coordinates that views and points have.
    ///
    /// # Errors
    /// A view that has no pose, and two ends in one place.
    pub(super) fn metres_per_unit(&self, views: &[WorldView], place: impl Fn(DVec3) -> DVec3) -> Result<f64, PrepareError> {
        let at = |end: &Landmark| match end {
            Landmark::Point(point) => Ok(*point),
            Landmark::View(name) => {
                let is_it = |view: &&WorldView| view.name == *name || view.files.iter().any(|file| file == name);
                let missing = || PrepareError::new(format!("known distance: no view {name} has a pose; {}", some_names(views)));
                views.iter().find(is_it).map(|view| place(view.eye())).ok_or_else(missing)
            }
        };
        let [a, b] = &self.ends;
        let distance = at(a)?.distance(at(b)?);
        let factor = self.metres / distance;
        if factor.is_normal() { Ok(factor) } else { Err(PrepareError::new(format!("known distance: {a} and {b} are in the same place"))) }
    }
}

fn some_names(views: &[WorldView]) -> String {
    let names: Vec<&str> = views.iter().take(3).map(|view| view.name.as_str()).collect();
    format!("those that have one: {}{}", names.join(", "), if views.len() > 3 { ", ..." } else { "" })
}
