//! Small scenes for tests.

use std::ops::Range;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, Sender, channel};

use glam::{DAffine3, DMat3, DVec2, DVec3};
use luxel_core::{
    Camera, CameraProjection, ColorSpace, Dataset, Distortion, Exchange, ExchangeError, Image, Mask, OnDemand, ReadError, Source, View,
};

/// A camera at `eye` that looks along +z, with a focal length of the image's width.
pub(crate) fn camera_at(eye: [f64; 3], size_px: [u32; 2]) -> Camera {
    camera_looking_at(DVec3::from_array(eye), DVec3::from_array(eye) + DVec3::Z, size_px)
}

/// A camera at `eye` with its axis through `target`; y is down.
pub(crate) fn camera_looking_at(eye: DVec3, target: DVec3, size_px: [u32; 2]) -> Camera {
    let forward = (target - eye).normalize();
    let right = DVec3::Y.cross(forward).normalize();
    let rotation = DMat3::from_cols(right, forward.cross(right), forward).transpose();
    Camera {
        camera_from_world: DAffine3 { matrix3: rotation, translation: -(rotation * eye) },
        focal_px: DVec2::splat(f64::from(size_px[0])),
        center_px: DVec2::new(f64::from(size_px[0]), f64::from(size_px[1])) / 2.0,
        size_px,
        distortion: Distortion::default(),
        projection: CameraProjection::Pinhole,
    }
}

pub(crate) fn view_of(name: &str, camera: Camera, image: Image) -> View {
    View::of_radiance(name, camera, image)
}

/// A data set with the training views `train` and without points.
pub(crate) fn dataset_of(train: Vec<View>) -> Dataset {
    Dataset {
        format: "test".to_owned(),
        train,
        test: Vec::new(),
        points: Vec::new(),
        color_space: ColorSpace::default(),
        bad_pixels: Vec::new(),
        fingerprint: "0123".to_owned(),
        warnings: Vec::new(),
        world_from_local: luxel_core::Similarity::IDENTITY,
        metres_per_unit: None,
        is_developed: false,
        readers: 2,
    }
}

/// A value that is copied each time it is read.
#[derive(Debug)]
struct Copied<T>(T);

impl Source<Image> for Copied<Image> {
    fn read(&self) -> Result<Image, ReadError> {
        Ok(self.0.clone())
    }

    fn stand_in(&self) -> Image {
        luxel_core::unreadable_image(self.0.width, self.0.height)
    }
}

impl Source<Mask> for Copied<Mask> {
    fn read(&self) -> Result<Mask, ReadError> {
        Ok(self.0.clone())
    }

    fn stand_in(&self) -> Mask {
        luxel_core::unreadable_mask(self.0.weights.len())
    }
}

/// The view with its image and mask read on demand.
pub(crate) fn on_demand(view: &View) -> View {
    let mask = view.mask.as_ref().map(|mask| OnDemand::from_source(Arc::new(Copied(Mask::clone(mask)))));
    View { image: OnDemand::from_source(Arc::new(Copied(Image::clone(&view.image)))), mask, ..view.clone() }
}

/// The connection of a rank that is a thread of the test.
pub(crate) struct ThreadExchange {
    rank: usize,
    to: Vec<Sender<Vec<u32>>>,
    from: Vec<Receiver<Vec<u32>>>,
}

impl Exchange for ThreadExchange {
    fn rank(&self) -> usize {
        self.rank
    }

    fn ranks(&self) -> usize {
        self.to.len()
    }

    fn all_to_all(&mut self, sent: &[u32], spans: &[Range<usize>], received: &mut [u32], lengths: &[usize]) -> Result<(), ExchangeError> {
        let gone = || ExchangeError("a rank is gone".to_owned());
        for (to, span) in self.to.iter().zip(spans) {
            to.send(sent[span.clone()].to_vec()).map_err(|_| gone())?;
        }
        let mut rest = received;
        for (from, length) in self.from.iter().zip(lengths) {
            let (message, after) = rest.split_at_mut(*length);
            message.copy_from_slice(&from.recv().map_err(|_| gone())?);
            rest = after;
        }
        Ok(())
    }

    fn all_gather_into(&mut self, sent: &[u32], received: &mut [u32], lengths: &[usize]) -> Result<(), ExchangeError> {
        let spans: Vec<Range<usize>> = self.to.iter().map(|_| 0..sent.len()).collect();
        self.all_to_all(sent, &spans, received, lengths)
    }
}

/// Runs `work` on each of `ranks` ranks, and returns their results in the order of ranks.
pub(crate) fn on_ranks<T: Send>(ranks: usize, work: impl Fn(ThreadExchange) -> T + Sync) -> Vec<T> {
    let mut exchanges: Vec<ThreadExchange> = (0..ranks).map(|rank| ThreadExchange { rank, to: Vec::new(), from: Vec::new() }).collect();
    for from in 0..ranks {
        for to in 0..ranks {
            let (sender, receiver) = channel();
            exchanges[from].to.push(sender);
            exchanges[to].from.push(receiver);
        }
    }
    std::thread::scope(|scope| {
        let work = &work;
        let threads: Vec<_> = exchanges.into_iter().map(|exchange| scope.spawn(move || work(exchange))).collect();
        threads.into_iter().map(|thread| thread.join().unwrap()).collect()
    })
}
