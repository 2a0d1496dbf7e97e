//! Photographs of a scene: through an aperture, while the shutter is open.

use luxel::photograph::{Aperture, Photograph, Sampling, ShutterMotion};
use numpy::PyArray3;
use pyo3::prelude::*;

use crate::arrays::image_array;
use crate::camera::PyCamera;
use crate::errors::invalid;
use crate::scene::{PyScene, View, device as opened};

#[pymethods]
impl PyScene {
    /// Renders the scene through a thin lens, or while the shutter is open: float32 [height, width,
    /// 3], linear radiance in the units of the data set. Things out of focus become discs, as
    /// bright as they are in the scene.
    ///
    /// Args: camera: where from, in the middle of the exposure; a pinhole. aperture: diameter of
    /// the aperture in world units; None for a pinhole. focus: distance along the camera's axis
    /// that is in focus, world units; with aperture. blades: straight blades of the aperture, 3 to
    /// 32; None for a circle. before, after: cameras of the frames before and after, which the
    /// camera comes from and goes to. shutter: part of the time from frame to frame in which the
    /// shutter is open, in degrees of 360. lens_samples: number of renders that the image is the
    /// mean of, 1 to 4096; None for as many as bring the estimate of the error to 1 %, 1024 at
    /// most. sample_set: 0 for all frames of a path, or another number in each. background,
    /// samples, device, threads: as in `render`.
    #[pyo3(signature = (
        camera, *, aperture=None, focus=None, blades=None, before=None, after=None, shutter=180.0, lens_samples=None, sample_set=0,
        background=None, samples=None, device="auto", threads=None
    ))]
    #[expect(clippy::too_many_arguments, reason = "keywords of a Python method")]
    fn photograph<'py>(
        &self,
        py: Python<'py>,
        camera: &PyCamera,
        aperture: Option<f64>,
        focus: Option<f64>,
        blades: Option<u8>,
        before: Option<&PyCamera>,
        after: Option<&PyCamera>,
        shutter: f64,
        lens_samples: Option<u32>,
        sample_set: u32,
        background: Option<[f32; 3]>,
        samples: Option<u8>,
        device: &str,
        threads: Option<u32>,
    ) -> PyResult<Bound<'py, PyArray3<f32>>> {
        let view = View { camera: camera.clone(), background, samples, device: opened(device, threads)? };
        let world_from_local = self.read(py, |scene| scene.world_from_local);
        let unit = world_from_local.scale();
        let aperture = match (aperture, focus) {
            (Some(diameter), Some(distance)) => Some(Aperture { diameter: diameter / unit, focus_distance: distance / unit, blades }),
            (Some(_), None) => return Err(invalid("focus: None, expected the distance in focus, since an aperture is given")),
            (None, Some(_)) => return Err(invalid("aperture: None, expected its diameter, since a focus is given")),
            (None, None) => None,
        };
        let seen = |other: Option<&PyCamera>| other.map(|camera| camera.seen_from(&world_from_local));
        let motion = (before.is_some() || after.is_some()).then(|| ShutterMotion {
            before: seen(before),
            after: seen(after),
            open: shutter / 360.0,
        });
        let sampling = Sampling { count: lens_samples, set: sample_set };
        let (radiance, _) = self.rendered(py, view, move |renderer, camera| {
            renderer.photograph(&Photograph { camera: camera.clone(), aperture, motion }, sampling)
        })?;
        image_array(py, radiance.into_image())
    }
}
