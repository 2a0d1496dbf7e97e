//! The network of a radiance field, as options have it.

use std::fmt;
use std::str::FromStr;

use serde::{Deserialize, Serialize};

/// The map from positions to density and colour.
///
/// ```
/// use luxel_train::FieldNetworkChoice;
///
/// let published: FieldNetworkChoice = "8x256".parse()?;
/// assert_eq!(published, FieldNetworkChoice::Layers { layers: 8, units: 256 });
/// assert_eq!(published.to_string(), "8x256");
/// # Ok::<(), String>(())
/// ```
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(into = "String", try_from = "String")]
pub enum FieldNetworkChoice {
    /// A hash grid with small networks.
    #[default]
    Grid,
    /// A network of so many layers, without a grid.
    Layers {
        /// Number of hidden layers.
        layers: u32,
        /// Units of a layer.
        units: u32,
    },
}

impl FromStr for FieldNetworkChoice {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let sizes = text.split_once('x').and_then(|(layers, units)| Some((layers.parse().ok()?, units.parse().ok()?)));
        match (text, sizes) {
            ("grid", _) => Ok(Self::Grid),
            (_, Some((layers, units))) => Ok(Self::Layers { layers, units }),
            _ => Err(format!("\"{text}\" is no network, expected grid, or layers and units such as 8x256")),
        }
    }
}

impl fmt::Display for FieldNetworkChoice {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Grid => f.write_str("grid"),
            Self::Layers { layers, units } => write!(f, "{layers}x{units}"),
        }
    }
}

impl From<FieldNetworkChoice> for String {
    fn from(choice: FieldNetworkChoice) -> Self {
        choice.to_string()
    }
}

impl TryFrom<String> for FieldNetworkChoice {
    type Error = String;

    fn try_from(text: String) -> Result<Self, String> {
        text.parse()
    }
}
