//! Side-by-side crops: the same window of a test view by every method and of the ground truth, at
//! two exposures.
//!
//! In: results of a data set. Out: HTML. Windows are chosen by the ground truth alone, not by the
//! renders: of two test views, at a quarter and three quarters of the list, the window a third as
//! long as the shorter side in which the logarithm of luminance varies most, where dark and bright
//! meet. Renders are those of the first seed. Degenerate: no test views, no section.

use std::fmt::Write as _;
use std::path::Path;

use luxel::Result;
use luxel::error::Context;
use luxel_core::tone::Tonemap;
use luxel_core::{ColorSpace, Image, luminance_rec709};
use luxel_metrics::LOG_FLOOR;

use super::matrix::Matrix;
use super::results::CellResult;
use crate::report::html::escape;
use crate::report::picture::{self, Display, Exposures, img, radiance, signed};
use crate::run::RunFolder;
use crate::run::evaluation::unique_stems;

/// Number of views per data set.
const VIEWS: usize = 2;
/// Ratio of the image's shorter side to the window's.
const WINDOW_SHARE: usize = 3;
/// Windows begin at multiples of their side divided by this.
const STRIDES: usize = 4;
/// Longest side of a picture in the page, pixels.
const MOST_PX: usize = 280;

/// A square part of an image, pixels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Window {
    x: usize,
    y: usize,
    side: usize,
}

/// An image in normalised units.
struct Shot {
    image: Image,
    color_space: ColorSpace,
}

/// Returns the crops of a data set; empty without test views.
pub(super) fn section(matrix: &Matrix, results: &[CellResult], source: usize) -> Result<String> {
    let by_method: Vec<&CellResult> =
        (0..matrix.methods.len()).filter_map(|method| results.iter().find(|cell| cell.source == source && cell.method == method)).collect();
    let Some(first) = by_method.first() else { return Ok(String::new()) };
    let names: Vec<&str> =
        first.metrics.splits.get("test").map_or_else(Vec::new, |split| split.views.iter().map(|view| view.name.as_str()).collect());
    let stems = unique_stems(names.iter().copied());
    let mut out = String::new();
    let count = VIEWS.min(names.len());
    for (name, stem) in (0..count).map(|i| (2 * i + 1) * names.len() / (2 * count)).filter_map(|i| Some((names.get(i)?, stems.get(i)?))) {
        out +=
            &view(matrix, &by_method, name, stem).with_context(|| format!("cannot show view {name} of {}", matrix.sources[source].name))?;
    }
    Ok(out)
}

/// Returns the crops of one view: its overview with the window marked, and the window at two
/// exposures.
fn view(matrix: &Matrix, cells: &[&CellResult], name: &str, stem: &str) -> Result<String> {
    let Some(first) = cells.first() else { return Ok(String::new()) };
    let truth = read(matrix, first, "gt", stem)?;
    let window = most_contrast(&truth.image);
    let exposures_ev = exposures_ev(&crop(&truth.image, window));
    let overview_ev = Exposures::new(picture::sample_luminances(std::iter::once(&truth.image))).overview_ev;
    let mut shots = vec![("ground truth".to_owned(), String::new(), crop(&truth.image, window), truth.color_space)];
    for cell in cells {
        let render = read(matrix, cell, "renders", stem)?;
        let psnr = cell.metrics.splits.get("test").and_then(|split| split.views.iter().find(|view| view.name == name));
        let psnr = psnr.map_or_else(String::new, |view| format!("{:.2} dB", view.metrics.psnr_scene));
        shots.push((matrix.methods[cell.method].name(), psnr, crop(&render.image, window), render.color_space));
    }
    let name = escape(name);
    let overview = Display { tonemap: Tonemap::Agx, exposure_ev: overview_ev, color_space: truth.color_space, max_side_px: MOST_PX };
    let percent = |part: usize, of: usize| 100.0 * part as f64 / of.max(1) as f64;
    let (width, height) = (truth.image.width, truth.image.height);
    let mut out = format!(
        "<h3>View {name}</h3><div class=\"crops\"><figure class=\"where\"><div>{}<span style=\"left:{:.2}%;top:{:.2}%;width:{:.2}%;height:{:.2}%\"></span></div>\
         <figcaption><b>where</b> AgX, {} EV</figcaption></figure>",
        img(&radiance(&truth.image, &overview)?, "", &format!("ground truth of view {name}")),
        percent(window.x, width),
        percent(window.y, height),
        percent(window.side, width),
        percent(window.side, height),
        signed(overview_ev),
    );
    for (what, psnr, image, color_space) in &shots {
        let what = escape(what);
        out += "<figure>";
        for exposure_ev in exposures_ev {
            let display = Display { tonemap: Tonemap::None, exposure_ev, color_space: *color_space, max_side_px: MOST_PX };
            out += &img(&radiance(image, &display)?, "", &format!("{what}, view {name}, {} EV", signed(exposure_ev)));
        }
        let _ = write!(out, "<figcaption><b>{what}</b> {psnr}</figcaption></figure>");
    }
    let _ = writeln!(
        out,
        "</div><p class=\"note\">Top row {} EV, bottom row {} EV, sRGB without a tone curve. Decibels are of the whole view, protocol scene.</p>",
        signed(exposures_ev[0]),
        signed(exposures_ev[1])
    );
    Ok(out)
}

/// Returns two exposures in whole stops: one brings a window's darkest quarter to a little below
/// middle grey, the other all but its brightest hundredth below white.
fn exposures_ev(window: &Image) -> [f32; 2] {
    let mut luminances = picture::sample_luminances(std::iter::once(window));
    luminances.retain(|luminance| *luminance > 0.0 && luminance.is_finite());
    luminances.sort_unstable_by(f32::total_cmp);
    let quantile = |share: f32| luminances.get((share * luminances.len() as f32) as usize).or(luminances.last()).copied().unwrap_or(1.0);
    let stops = |to: f32, from: f32| (to / from).log2().clamp(-16.0, 16.0);
    let dark = stops(0.12, quantile(0.25)).round();
    // The pictures shall differ where there is little contrast, too.
    [dark, stops(0.8, quantile(0.99)).floor().min(dark - 2.0)]
}

/// Reads an image of a cell's last evaluation.
fn read(matrix: &Matrix, cell: &CellResult, kind: &str, stem: &str) -> Result<Shot> {
    let folder = RunFolder::at(&matrix.root.join(&cell.place));
    let path = folder.evaluation(cell.metrics.iterations).join(kind).join(Path::new(&format!("{stem}.exr")));
    let decoded = luxel_io::read_image(&path, &Default::default()).context("cannot read an evaluation image")?;
    let mut image = decoded.image;
    cell.metrics.radiance_scale.normalise(&mut image);
    Ok(Shot { image, color_space: decoded.color_space.unwrap_or_default() })
}

/// Returns the window in which the logarithm of luminance has the greatest variance; the first of
/// equals.
fn most_contrast(image: &Image) -> Window {
    let side = (image.width.min(image.height) / WINDOW_SHARE).max(1);
    let stride = (side / STRIDES).max(1);
    let logs: Vec<f64> = image.pixels.iter().map(|&p| f64::from(luminance_rec709(p).max(LOG_FLOOR)).log10()).collect();
    let variance = |window: &Window| {
        let rows = logs.chunks_exact(image.width.max(1)).skip(window.y).take(side);
        let values = rows.flat_map(|row| row.iter().skip(window.x).take(side));
        let (sum, squares) = values.fold((0.0, 0.0), |(sum, squares), v| (sum + v, squares + v * v));
        let count = (side * side) as f64;
        squares / count - (sum / count).powi(2)
    };
    let starts = |length: usize| (0..=length.saturating_sub(side)).step_by(stride);
    let windows = starts(image.height).flat_map(|y| starts(image.width).map(move |x| Window { x, y, side }));
    let mut best = (Window { x: 0, y: 0, side }, f64::NEG_INFINITY);
    for window in windows {
        let found = variance(&window);
        if found > best.1 {
            best = (window, found);
        }
    }
    best.0
}

fn crop(image: &Image, window: Window) -> Image {
    let rows = window.y..(window.y + window.side).min(image.height);
    let columns = window.x..(window.x + window.side).min(image.width);
    let (width, height) = (columns.len(), rows.len());
    let pixels = rows.flat_map(|y| columns.clone().map(move |x| (x, y))).map(|(x, y)| image.at(x, y)).collect();
    Image { width, height, pixels }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_window_is_where_dark_and_bright_meet() {
        let mut image = Image::filled(60, 40, [0.01; 3]);
        for (i, pixel) in image.pixels.iter_mut().enumerate() {
            if i % 60 >= 46 && i / 60 < 14 {
                *pixel = [100.0; 3];
            }
        }
        let window = most_contrast(&image);
        assert_eq!(window.side, 13);
        assert!(window.x > 30 && window.y < 14, "{window:?}");
        let cropped = crop(&image, window);
        assert_eq!((cropped.width, cropped.height, cropped.pixels.len()), (13, 13, 169));
        let (dark, bright) = (cropped.pixels.iter().filter(|p| p[0] < 1.0).count(), cropped.pixels.iter().filter(|p| p[0] > 1.0).count());
        assert!(dark > 40 && bright > 40, "{dark} {bright}");
    }

    #[test]
    fn exposures_show_the_dark_and_the_bright_of_a_window() {
        let mut window = Image::filled(10, 10, [0.03; 3]);
        for pixel in &mut window.pixels[..30] {
            *pixel = [12.8; 3];
        }
        assert_eq!(exposures_ev(&window), [2.0, -4.0]);
        assert_eq!(exposures_ev(&Image::filled(3, 3, [0.12; 3])), [0.0, -2.0]);
        assert!(exposures_ev(&Image::filled(2, 2, [0.0; 3])).iter().all(|ev| ev.is_finite()));
    }

    #[test]
    fn tiny_and_flat_images_have_a_window() {
        for (width, height) in [(1, 1), (2, 7), (5, 3)] {
            let window = most_contrast(&Image::filled(width, height, [0.0; 3]));
            assert_eq!((window.x, window.y), (0, 0));
            let cropped = crop(&Image::filled(width, height, [0.0; 3]), window);
            assert_eq!([cropped.width, cropped.height], [window.side; 2]);
            assert!(window.side >= 1 && window.side <= width.min(height), "{window:?}");
        }
    }
}
