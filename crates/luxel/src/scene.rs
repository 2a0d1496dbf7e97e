//! A scene: splats of radiance, and all that is needed to render them as they were trained.

use std::ops::Deref;
use std::path::Path;

use luxel_core::Edit;
use luxel_core::edit::{Applied, MaskShares, ShMap};
use luxel_io::PathCamera;
use luxel_train::{ANCHOR_FORMAT, FIELD_FORMAT};

use crate::error::Context;
use crate::export::{Exported, export};
use crate::probe::probe;
use crate::{
    Bake, Device, DeviceOptions, Error, ExportOptions, Observer, Probe, ProbeOptions, Remedy, Result, SelectedEngine, Silent, output,
};

/// A scene. Dereferences to [`luxel_core::Scene`], whose splats are in normalised units.
///
/// ```
/// use luxel::{Scene, synthetic};
///
/// # fn main() -> luxel::Result<()> {
/// let folder = tempfile::tempdir().unwrap();
/// let path = folder.path().join("room.ply");
/// let scene = synthetic::room(100, 1);
/// scene.save(&path)?;
/// assert_eq!(Scene::open(&path)?, scene);
/// # Ok(())
/// # }
/// ```
#[derive(Clone, Debug, PartialEq)]
pub struct Scene(luxel_core::Scene);

impl Scene {
    /// Reads a scene file. Formats are PLY of this program, plain and compressed 3DGS PLY, USD as
    /// text, binary or package, GLB and SPZ, recognised by content.
    ///
    /// # Errors
    /// A file that cannot be read, is damaged, or is of a format or version that is not supported;
    /// a folder.
    pub fn open(path: impl AsRef<Path>) -> Result<Self> {
        Self::open_reporting(path, &Silent)
    }

    /// Reads a scene as [`Self::open`] does, and reports what was left out or assumed.
    ///
    /// # Errors
    /// As [`Self::open`].
    pub fn open_reporting(path: impl AsRef<Path>, observer: &dyn Observer) -> Result<Self> {
        let path = path.as_ref();
        if path.is_dir() {
            let error = Error::new(format!("{}: is a folder, expected the file of a scene", path.display()));
            let advice = "name the file; the scene of a run is point_cloud/iteration_N/point_cloud.ply in its folder";
            return Err(error.with_remedy(Remedy::advice(advice)));
        }
        refuse_non_splat(path)?;
        let file = luxel_io::read_scene_file(path).context("cannot read the scene")?;
        file.warnings.iter().for_each(|warning| observer.warn(&format!("{}: {warning}", path.display())));
        Ok(Self(file.scene))
    }

    /// Writes the scene as PLY, whole or not at all: the exact model, and a tone-mapped preview
    /// that any 3DGS viewer shows.
    ///
    /// # Errors
    /// A name with another extension than `.ply`; a scene that is not valid; the file system's
    /// refusal.
    pub fn save(&self, path: impl AsRef<Path>) -> Result<()> {
        output::check_extension(path.as_ref(), &["ply"])?;
        luxel_io::write_scene_ply(path.as_ref(), &self.0).context("cannot write the scene")
    }

    /// Changes the light of the scene, and adds the edit to its record.
    ///
    /// Selections of painted masks need their projection onto the splats, and are an error here.
    ///
    /// ```
    /// use luxel::{Edit, synthetic};
    ///
    /// # fn main() -> luxel::Result<()> {
    /// let mut scene = synthetic::room(100, 1);
    /// let edit: Edit = "where L > p95 ~1; gain 0.5".parse()?;
    /// let applied = scene.edit(&edit)?;
    /// assert!(applied.weights.iter().any(|weight| *weight > 0.0));
    /// assert_eq!(scene.edits.len(), 1);
    /// # Ok(())
    /// # }
    /// ```
    ///
    /// # Errors
    /// An edit that does not go with the scene; the scene is unchanged then.
    pub fn edit(&mut self, edit: &Edit) -> Result<Applied> {
        edit.apply(&mut self.0, &MaskShares::new(), ShMap::default()).with_context(|| format!("cannot apply \"{edit}\""))
    }

    /// Exports the scene for other programs, in the format of the path's extension. The bake is
    /// neither measured nor refined, as both need views; [`crate::export::export`] takes them.
    ///
    /// ```
    /// use luxel::{Bake, ColorSpace, synthetic};
    ///
    /// # fn main() -> luxel::Result<()> {
    /// # let folder = tempfile::tempdir().unwrap();
    /// # let path = folder.path().join("room.usda");
    /// let exported = synthetic::room(100, 1).export(&path, Bake::linear(ColorSpace::AcesCg))?;
    /// assert_eq!((exported.splats, exported.color_space), (100, Some(ColorSpace::AcesCg)));
    /// # Ok(())
    /// # }
    /// ```
    ///
    /// # Errors
    /// A bake that the format cannot hold; the file system's refusal.
    pub fn export(&self, path: impl AsRef<Path>, bake: Bake) -> Result<Exported> {
        let options = ExportOptions { bake, ..ExportOptions::default() };
        // Without views the engine has nothing to do; the processor's is always there.
        let mut engine = SelectedEngine::open(&Device::Cpu.into())?.engine;
        export(self.0.clone(), path.as_ref(), &options, None, engine.as_mut(), &Silent)
    }

    /// Renders the light that arrives at a point as an environment map. The up direction and the
    /// resolution are those of no data set; [`crate::probe::probe`] takes one.
    ///
    /// ```
    /// use luxel::{Device, ProbeOptions, synthetic};
    ///
    /// # fn main() -> luxel::Result<()> {
    /// let options = ProbeOptions { width_px: 16, ..ProbeOptions::at([0.0; 3]) };
    /// let probe = synthetic::room(200, 1).probe(&options, Device::Cpu)?;
    /// assert_eq!((probe.width(), probe.height()), (16, 8));
    /// assert!(probe.summary.peak_radiance > 0.0);
    /// # Ok(())
    /// # }
    /// ```
    ///
    /// # Errors
    /// A device that is not there or gave up.
    pub fn probe(&self, options: &ProbeOptions, device: impl Into<DeviceOptions>) -> Result<Probe> {
        let mut engine = SelectedEngine::open(&device.into())?.engine;
        probe(self.0.clone(), options, None, engine.as_mut(), &Silent)
    }

    /// Returns the scene as the engines and file writers take it.
    pub fn into_core(self) -> luxel_core::Scene {
        self.0
    }
}

impl From<luxel_core::Scene> for Scene {
    fn from(scene: luxel_core::Scene) -> Self {
        Self(scene)
    }
}

impl Deref for Scene {
    type Target = luxel_core::Scene;

    fn deref(&self) -> &luxel_core::Scene {
        &self.0
    }
}

/// Refuses a file of a field or of anchors, which have no splats.
fn refuse_non_splat(path: &Path) -> Result<()> {
    if path.extension().is_none_or(|extension| extension != "safetensors") {
        return Ok(());
    }
    let kinds = [(FIELD_FORMAT, "a radiance field, which has"), (ANCHOR_FORMAT, "anchors, which have")];
    let Some((_, words)) = kinds.into_iter().find(|(format, _)| luxel_io::holds_arrays(path, format)) else { return Ok(()) };
    let message = format!("{}: holds {words} no splats", path.display());
    Err(Error::new(message).with_remedy(Remedy::advice("name the folder of its run to render or evaluate it")))
}

/// Reads the cameras of a file, in the coordinates of the data set (world): a `transforms.json`,
/// whose images are not needed, or a camera path of nerfstudio.
///
/// # Errors
/// A file that cannot be read, or that leaves out the size of the images or the lens.
pub fn read_cameras(path: impl AsRef<Path>) -> Result<Vec<PathCamera>> {
    luxel_io::read_camera_path(path.as_ref(), None).context("cannot read the cameras")
}

/// Decodes the cameras of a file's bytes as [`read_cameras`] does; `name` is for errors.
///
/// # Errors
/// As [`read_cameras`].
pub fn decode_cameras(name: &str, bytes: &[u8]) -> Result<Vec<PathCamera>> {
    luxel_io::decode_camera_path(Path::new(name), bytes, None).context("cannot read the cameras")
}
