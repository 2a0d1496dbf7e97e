//! The choice of what computes: the processor's cores or a GPU.
//!
//! In: a [`Device`] and a number of threads; out: an engine without a scene, and words for where it
//! runs. `Auto` takes a separate card if there is one that works; any other GPU must first be
//! clearly faster than the processor in a short measurement (`device/trial.rs`); else it takes the
//! CPU. Captured LDR images and methods on pairs are trained on the CPU, the only engine for them.

use std::error::Error as _;
use std::fmt;
use std::str::FromStr;

use luxel_core::{Engine, text};
use luxel_cpu::{CpuEngine, InstructionSet};
use serde::{Deserialize, Serialize};

use crate::error::{Context, ensure};
use crate::{Error, Remedy, Result, memory};

mod processor;
mod trial;

pub use self::processor::processor_name;

/// A choice of what computes: the processor or a GPU.
///
/// The text form is `auto`, `cpu`, `gpu` or `gpu:NAME`:
///
/// ```
/// use luxel::Device;
///
/// assert_eq!("gpu:H200".parse(), Ok(Device::Named("H200".into())));
/// assert_eq!(Device::default().to_string(), "auto");
/// assert!("cuda".parse::<Device>().is_err());
/// ```
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub enum Device {
    /// A GPU if there is a real one that is not slower than the CPU, else the CPU.
    #[default]
    Auto,
    /// The processor's cores.
    Cpu,
    /// The best GPU; none is an error.
    Gpu,
    /// The GPU whose name contains this text, a software renderer too.
    Named(String),
}

impl Device {
    /// Returns this device with a number of threads in place of all cores.
    pub fn with_threads(self, threads: u32) -> DeviceOptions {
        DeviceOptions { device: self, threads: Some(threads) }
    }

    /// Returns whether this asks for a GPU and nothing else.
    pub fn is_gpu(&self) -> bool {
        matches!(self, Self::Gpu | Self::Named(_))
    }
}

impl FromStr for Device {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text {
            "auto" => Ok(Self::Auto),
            "cpu" => Ok(Self::Cpu),
            "gpu" => Ok(Self::Gpu),
            _ => match text.strip_prefix("gpu:") {
                Some(name) if !name.is_empty() => Ok(Self::Named(name.into())),
                _ => Err(format!("unknown device \"{text}\", expected auto, cpu, gpu or gpu:NAME with a part of the GPU's name")),
            },
        }
    }
}

impl fmt::Display for Device {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Auto => f.write_str("auto"),
            Self::Cpu => f.write_str("cpu"),
            Self::Gpu => f.write_str("gpu"),
            Self::Named(name) => write!(f, "gpu:{name}"),
        }
    }
}

impl TryFrom<String> for Device {
    type Error = String;

    fn try_from(text: String) -> Result<Self, String> {
        text.parse()
    }
}

impl From<Device> for String {
    fn from(device: Device) -> Self {
        device.to_string()
    }
}

/// Greatest number of threads that may be asked for.
pub const MAX_THREADS: u32 = 4096;

/// A device and the threads beside it. The result is the same for any number of threads; CPU and
/// GPU agree to rounding.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DeviceOptions {
    /// The device.
    pub device: Device,
    /// Threads of the processor; `None` for all cores.
    pub threads: Option<u32>,
}

impl From<Device> for DeviceOptions {
    fn from(device: Device) -> Self {
        Self { device, threads: None }
    }
}

/// An engine without a scene, and where it runs.
pub struct SelectedEngine {
    /// The engine.
    pub engine: Box<dyn Engine>,
    /// Threads for everything that the processor does.
    pub threads: usize,
    /// Place where it runs, for people: `2 threads`, `NVIDIA H200 (vulkan)`; with the reason where
    /// there seems to be a GPU that is not used.
    pub machine: String,
    /// The same for comparisons: `2 threads of AMD EPYC 9B14`, `NVIDIA H200 (vulkan)`. Times of
    /// equal ones compare.
    pub computed_by: String,
    /// Name of the GPU.
    pub gpu: Option<String>,
    /// The processor's instruction set, if it is the engine.
    pub instruction_set: Option<String>,
}

impl SelectedEngine {
    /// Opens the engine for rendering, measuring and editing.
    ///
    /// # Errors
    /// A GPU that was asked for and is not there or does not work.
    pub fn open(options: &DeviceOptions) -> Result<Self> {
        Self::open_with(options, InstructionSet::Best)
    }

    /// Opens the engine for training. `needs_cpu` is set for what the CPU engine alone does: find a
    /// camera's response beside the scene, and steps of methods on pairs.
    ///
    /// # Errors
    /// As [`Self::open`].
    pub fn for_training(options: &DeviceOptions, needs_cpu: bool) -> Result<Self> {
        if needs_cpu && options.device == Device::Auto {
            return cpu(threads(options)?, InstructionSet::Best, None);
        }
        Self::open(options)
    }

    /// Opens the processor's engine for a task that no GPU does, such as a radiance field; `reason`
    /// says so where the device was left open.
    ///
    /// # Errors
    /// A GPU that was asked for.
    pub fn on_processor(options: &DeviceOptions, reason: &str) -> Result<Self> {
        if options.device.is_gpu() {
            return Err(Error::new(reason.to_owned()).with_remedy(Remedy::set("device", "cpu")));
        }
        let is_open = options.device == Device::Auto;
        cpu(threads(options)?, InstructionSet::Best, is_open.then(|| reason.to_owned()))
    }

    /// Opens the engine with a choice among the processor's instruction sets.
    ///
    /// # Errors
    /// As [`Self::open`]; a GPU together with an instruction set; an instruction set that the
    /// processor lacks.
    pub fn open_with(options: &DeviceOptions, set: InstructionSet) -> Result<Self> {
        let threads = threads(options)?;
        if set != InstructionSet::Best {
            ensure!(!options.device.is_gpu(), "an instruction set is the processor's, and the device is a GPU");
            return cpu(threads, set, None);
        }
        match &options.device {
            Device::Cpu => cpu(threads, set, None),
            Device::Auto => match gpu::best(threads) {
                Ok(Found { selected, needs_trial: false }) => Ok(selected),
                Ok(Found { selected, needs_trial: true }) => Ok(faster(selected, cpu(threads, set, None)?)),
                Err(reason) => cpu(threads, set, reason),
            },
            Device::Gpu => gpu::open(threads, None),
            Device::Named(name) => gpu::open(threads, Some(name)),
        }
    }
}

/// Opens the CPU engine; `reason` says why it is not the GPU's.
fn cpu(threads: usize, set: InstructionSet, reason: Option<String>) -> Result<SelectedEngine> {
    let mut engine = CpuEngine::new(threads).context("cannot start the CPU engine")?;
    engine.set_instruction_set(set).context("cannot use this instruction set")?;
    engine.set_tile_memory(usize::try_from(memory::tile_bytes()).unwrap_or(usize::MAX));
    let instruction_set = Some(engine.instruction_set());
    let mut place = text::plural(threads, "thread");
    let computed_by = format!("{place} of {}", processor_name().unwrap_or_else(|| "the CPU".into()));
    if let Some(reason) = reason {
        place += &format!(" ({reason})");
    }
    Ok(SelectedEngine { engine: Box::new(engine), threads, machine: place, computed_by, gpu: None, instruction_set })
}

/// A GPU that [`Device::Auto`] may take.
struct Found {
    selected: SelectedEngine,
    /// Whether it may be slower than the processor.
    needs_trial: bool,
}

/// Returns the faster of two engines, by a short measurement.
fn faster(mut gpu: SelectedEngine, mut processor: SelectedEngine) -> SelectedEngine {
    let times = [&mut gpu, &mut processor].map(|selected| trial::step_time(selected.engine.as_mut()));
    let Some(reason) = trial::reason_against(&times[0], &times[1]) else { return gpu };
    processor.machine += &format!(" ({}: {reason})", gpu.machine);
    processor
}

#[cfg(feature = "gpu")]
mod gpu {
    use luxel_gpu::{AdapterKind, DeviceChoice, Gpu, GpuEngine, adapters};

    use super::{Found, Result, SelectedEngine};

    pub(super) fn open(threads: usize, name: Option<&str>) -> Result<SelectedEngine> {
        Ok(find(threads, name)?.selected)
    }

    fn find(threads: usize, name: Option<&str>) -> Result<Found> {
        let choice = name.map_or(DeviceChoice::Best, |name| DeviceChoice::Named(name.to_owned()));
        let gpu = Gpu::open(&choice)?;
        let engine = GpuEngine::new(&gpu)?;
        let facts = gpu.facts();
        let machine = format!("{} ({})", facts.name, facts.backend);
        let (computed_by, name, needs_trial) = (machine.clone(), facts.name.clone(), facts.needs_trial());
        let selected = SelectedEngine { engine: Box::new(engine), threads, machine, computed_by, gpu: Some(name), instruction_set: None };
        Ok(Found { selected, needs_trial })
    }

    /// Opens the best real GPU. Without one there is nothing to report; one that cannot be used is
    /// reported.
    pub(super) fn best(threads: usize) -> Result<Found, Option<String>> {
        find(threads, None).map_err(|error| {
            let is_there = adapters().iter().any(|facts| facts.kind != AdapterKind::Software);
            is_there.then(|| format!("{error:#}"))
        })
    }
}

#[cfg(not(feature = "gpu"))]
mod gpu {
    use super::{Found, Result, SelectedEngine};
    use crate::{Error, Remedy};

    pub(super) fn open(_: usize, _: Option<&str>) -> Result<SelectedEngine> {
        let remedy = Remedy::set("device", "cpu");
        Err(Error::new("this build of luxel has no GPU engine (cargo feature gpu)").with_remedy(remedy))
    }

    pub(super) fn best(_: usize) -> Result<Found, Option<String>> {
        Err(None)
    }
}

/// Starts the threads that files are decoded with, and all else outside of the engine: as many as
/// asked for, else one per core. Only the first call of a process has an effect; a program calls it
/// before it reads anything.
///
/// # Errors
/// A number that is not from 1 to [`MAX_THREADS`]; the system refuses as many threads.
pub fn start_threads(threads: Option<u32>) -> Result<()> {
    if let Some(threads) = threads.filter(|threads| !(1..=MAX_THREADS).contains(threads)) {
        let error = Error::new(format!("threads: found {threads}, expected 1 to {MAX_THREADS}"));
        return Err(error.with_remedy(Remedy::set("threads", "a number in that range").or(Remedy::leave_out("threads"))));
    }
    let count = threads.map_or(0, |threads| threads as usize);
    match rayon::ThreadPoolBuilder::new().num_threads(count).spawn_handler(luxel_lanes::start_thread).build_global() {
        // Without a cause, the error is that the threads run already.
        Err(error) if error.source().is_some() => {
            let count = threads.map_or_else(|| std::thread::available_parallelism().map_or(1, usize::from), |threads| threads as usize);
            let remedy = Remedy::lower("threads").or(Remedy::advice("raise the limit on processes"));
            Err(Error::new(format!("cannot start {}: {error}", text::plural(count, "thread"))).with_remedy(remedy))
        }
        _ => Ok(()),
    }
}

/// Returns the threads to use: as many as asked for, else all cores. Also bounds what reading files
/// uses.
fn threads(options: &DeviceOptions) -> Result<usize> {
    start_threads(options.threads)?;
    Ok(match options.threads {
        Some(threads) => threads as usize,
        None => std::thread::available_parallelism().map_or(1, usize::from),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_of_threads_out_of_range_are_refused_wherever_they_come_from() {
        for threads in [0, 4097, 20_000, u32::MAX] {
            let error = start_threads(Some(threads)).unwrap_err();
            assert!(error.to_string().contains(&format!("threads: found {threads}, expected 1 to 4096")), "{error}");
            assert!(SelectedEngine::open(&Device::Cpu.with_threads(threads)).is_err());
        }
    }

    #[test]
    fn devices_parse_back() {
        for device in [Device::Auto, Device::Cpu, Device::Gpu, Device::Named("H200 NVL".into())] {
            assert_eq!(device.to_string().parse(), Ok(device));
        }
        for text in ["", "gpu:", "GPU", "cuda", "gpu h200"] {
            let error = text.parse::<Device>().unwrap_err();
            assert!(error.contains(&format!("\"{text}\"")) && error.contains("gpu:NAME"), "{error}");
        }
    }
}
