//! The native part of the Python package `luxel`: module `luxel._luxel`. The package in `python/`
//! re-exports it and adds what is best written in Python.
//!
//! Nothing here decides anything: arrays and keyword arguments become the library's types, and its
//! results and errors become Python's. Work is done without Python's lock (GIL), on a thread of its
//! own, while this one looks for Ctrl-C.

mod arrays;
mod camera;
mod camera_files;
mod color_model;
mod command;
mod dataset;
mod errors;
mod images;
mod json;
mod lens;
mod light_and_mesh;
mod metrics;
mod names;
mod observer;
mod options;
mod photograph;
mod probe;
mod process;
mod raster_arrays;
mod rasterization;
mod scene;
mod scene_arrays;
mod scene_output;
mod splats;
mod training;
mod wait;

use pyo3::prelude::*;

#[pymodule(gil_used = false)]
fn _luxel(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add("__version__", luxel::VERSION)?;
    module.add("LuxelError", module.py().get_type::<errors::LuxelError>())?;
    module.add_class::<camera::PyCamera>()?;
    module.add_class::<dataset::PyDataset>()?;
    module.add_class::<dataset::PyView>()?;
    module.add_class::<scene::PyScene>()?;
    module.add_class::<probe::PyProbe>()?;
    module.add_class::<light_and_mesh::PyLights>()?;
    module.add_class::<light_and_mesh::PyMesh>()?;
    module.add_class::<training::PyTraining>()?;
    module.add_class::<training::PyProgress>()?;
    module.add_class::<rasterization::PyRasterizer>()?;
    module.add_class::<rasterization::PyProjection>()?;
    module.add_class::<rasterization::PyBlending>()?;
    module.add_function(wrap_pyfunction!(raster_arrays::spatial_order, module)?)?;
    module.add_function(wrap_pyfunction!(camera_files::read_cameras, module)?)?;
    module.add_function(wrap_pyfunction!(camera_files::write_cameras, module)?)?;
    module.add_function(wrap_pyfunction!(images::read_image, module)?)?;
    module.add_function(wrap_pyfunction!(images::write_exr, module)?)?;
    module.add_function(wrap_pyfunction!(images::write_preview, module)?)?;
    module.add_function(wrap_pyfunction!(images::convert_color_space, module)?)?;
    module.add_function(wrap_pyfunction!(metrics::compare, module)?)?;
    module.add_function(wrap_pyfunction!(metrics::compare_files, module)?)?;
    module.add_function(wrap_pyfunction!(options::training_options, module)?)?;
    module.add_function(wrap_pyfunction!(command::run_command, module)?)?;
    module.add_function(wrap_pyfunction!(command::main, module)?)?;
    Ok(())
}
