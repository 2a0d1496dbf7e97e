//! `captures.json` of the run folder: the gains of the training images, the camera's response, the
//! vignetting of the lenses and the tone mappers that training found.

use std::collections::BTreeMap;

use luxel::Result;
use luxel::error::Context;
use luxel_core::response::exposure_of_knot;
use luxel_core::{Knots, RESPONSE_KNOTS, View};
use luxel_train::{LensVignetting, Reconstruction, ToneMapperRecord};
use serde::{Deserialize, Serialize};

use super::RunFolder;
use crate::{files, schema, text};

/// The file is some kilobytes, and a line an image.
const LIMIT_BYTES: u64 = 64 << 20;

/// Content of the file.
#[derive(Debug, Default, Serialize, Deserialize)]
pub struct Captures {
    /// Steps after which they were found.
    #[serde(default)]
    iteration: u32,
    /// Gains of the training images, stops by channel: what each was divided by. Their mean is 0.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    gains_ev: BTreeMap<String, [f32; 3]>,
    /// Response of the camera.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    response: Option<ResponseTable>,
    /// Vignetting of each lens; none if it was not learned.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    vignetting: Vec<LensVignetting>,
    /// Tone mappers of the method, from radiance and exposure to captured values; none for most.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    tone_mappers: Option<ToneMapperRecord>,
}

/// A response at its knots.
#[derive(Debug, Serialize, Deserialize)]
struct ResponseTable {
    /// Radiance times seconds.
    exposure: [f64; RESPONSE_KNOTS],
    /// Recorded values for it, red, green and blue.
    recorded: Knots,
}

impl ResponseTable {
    fn new(recorded: Knots) -> Self {
        Self { exposure: std::array::from_fn(exposure_of_knot), recorded }
    }
}

impl Captures {
    /// Returns the gains, the response and the vignetting of a trainer, which was trained on
    /// `train`.
    pub fn new(trainer: &dyn Reconstruction, train: &[View]) -> Self {
        let logs = trainer.log_gains().unwrap_or_default();
        let stops = |log: &[f32; 3]| log.map(|log| log / std::f32::consts::LN_2);
        let gains_ev = train.iter().zip(logs).map(|(view, log)| (view.name.clone(), stops(log))).collect();
        let vignetting = trainer.vignetting().unwrap_or_default();
        let (response, tone_mappers) = (trainer.response().map(ResponseTable::new), trainer.tone_mappers());
        Self { iteration: trainer.iteration(), gains_ev, response, vignetting, tone_mappers }
    }

    /// Writes the file, if there is anything to write.
    ///
    /// # Errors
    /// The file system's refusal.
    pub fn write(&self, folder: &RunFolder) -> Result<()> {
        if self.gains_ev.is_empty() && self.response.is_none() && self.vignetting.is_empty() && self.tone_mappers.is_none() {
            return Ok(());
        }
        files::write_json(&folder.captures(), schema::CAPTURES, self)
    }

    /// Reads the file; a run without one has no gains, response or vignetting.
    ///
    /// # Errors
    /// A file that cannot be read or has another content.
    pub fn read(folder: &RunFolder) -> Result<Self> {
        let path = folder.captures();
        if !path.is_file() {
            return Ok(Self::default());
        }
        let text = files::read_text(&path, LIMIT_BYTES)?;
        serde_json::from_str(&text)
            .with_context(|| format!("{}: not a file of gains and responses", path.display()))
            .map_err(|error| error.with_remedy(super::state::continue_run()))
    }

    /// Returns the ln gains of the training images after `iteration` steps, by name; empty if the
    /// file is of another step, or without gains.
    pub fn log_gains_at(&self, iteration: u32) -> BTreeMap<String, [f32; 3]> {
        let is_current = self.iteration == iteration;
        let gains = self.gains_ev.iter().filter(|_| is_current);
        gains.map(|(name, stops)| (name.clone(), stops.map(|stops| stops * std::f32::consts::LN_2))).collect()
    }

    /// Returns the response's knots after `iteration` steps; `None` if the file is of another step.
    pub fn response_at(&self, iteration: u32) -> Option<Knots> {
        self.response.as_ref().filter(|_| self.iteration == iteration).map(|response| response.recorded)
    }

    /// Returns the vignetting of each lens after `iteration` steps; `None` if the file is of
    /// another step or has none.
    pub fn vignetting_at(&self, iteration: u32) -> Option<&[LensVignetting]> {
        Some(&*self.vignetting).filter(|lenses| self.iteration == iteration && !lenses.is_empty())
    }
}

/// Returns the vignetting in words: the gain in the corners of each lens, in stops.
pub fn vignetting_text(lenses: &[LensVignetting]) -> String {
    let of_lens = |lens: &LensVignetting| {
        let [width, height] = lens.size_px;
        format!("{:+.2} EV in the corners ({width} x {height}, {})", lens.corner_ev, text::plural(lens.views, "view"))
    };
    lenses.iter().map(of_lens).collect::<Vec<_>>().join("; ")
}
