//! Pictures of the test views: a comparison to wipe, featured views in full, and all others small.

use std::fmt::Write as _;
use std::ops::RangeInclusive;

use luxel::Result;
use luxel_core::Image;
use luxel_core::tone::Tonemap;
use luxel_metrics::ViewMetrics;

use super::html::escape;
use super::picture::{self, Display, Exposures, INFERNO, Picture, error_map, figure, img, mu_error, radiance, signed};
use super::{ReportInput, ReportView};

/// Number of views with exposure pairs: the best, the worst and those in between.
const FEATURED: usize = 4;
/// Budgets of PNG bytes for all featured pictures, and for all small ones.
const FEATURED_BUDGET_BYTES: usize = 4_500_000;
const SMALL_BUDGET_BYTES: usize = 1_800_000;
/// Pictures of a featured view and of a small one.
const FEATURED_PICTURES: usize = 7;
const SMALL_PICTURES: usize = 3;
/// Limits of a picture's side when it is fitted to a budget, pixels.
const FEATURED_SIDES_PX: RangeInclusive<usize> = 128..=640;
const SMALL_SIDES_PX: RangeInclusive<usize> = 48..=160;
/// Estimate of PNG bytes per pixel, between those of flat and of noisy interiors.
const BYTES_PER_PIXEL: f64 = 2.0;
/// Full scales of the error map, from which the smallest is taken that holds 99.5 % of the pixels.
const ERROR_SCALES: [f32; 7] = [0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0];

/// The HTML of all pictures.
pub(super) struct Pictures {
    hero: String,
    sections: String,
}

/// The settings that all pictures share.
struct Gallery<'a> {
    input: &'a ReportInput,
    exposures: Exposures,
    error_scale: f32,
}

impl Pictures {
    /// Renders and encodes.
    pub(super) fn new(input: &ReportInput) -> Result<Self> {
        if input.views.is_empty() {
            return Ok(Self {
                hero: String::new(),
                sections: "<section><h2>Views</h2><p>No view was held out, so there is nothing to compare.</p></section>\n".into(),
            });
        }
        let luminances = picture::sample_luminances(input.views.iter().map(|view| &view.target));
        let gallery = Gallery { input, exposures: Exposures::new(luminances), error_scale: error_scale(input) };
        // Worst first.
        let mut order: Vec<&ReportView> = input.views.iter().collect();
        order.sort_by(|a, b| a.metrics.psnr_scene.total_cmp(&b.metrics.psnr_scene));
        let hero = order.get(order.len() / 2).map_or(Ok(String::new()), |view| gallery.hero(view))?;
        let featured = spread(&order, FEATURED);
        let others: Vec<&ReportView> =
            input.views.iter().filter(|view| !featured.iter().any(|featured| std::ptr::eq(featured.view, *view))).collect();
        Ok(Self { hero, sections: gallery.featured(&featured)? + &gallery.others(&others)? })
    }

    /// The comparison at the top of the page.
    pub(super) fn hero(&self) -> &str {
        &self.hero
    }

    /// Everything else.
    pub(super) fn sections(&self) -> &str {
        &self.sections
    }
}

/// A view with its rank, 0 for the worst.
#[derive(Clone, Copy)]
struct RankedView<'a> {
    rank: usize,
    view: &'a ReportView,
}

/// Returns up to `count` of `order` with their rank, evenly from the first to the last.
fn spread<'a>(order: &[&'a ReportView], count: usize) -> Vec<RankedView<'a>> {
    let (n, count) = (order.len(), order.len().min(count));
    (0..count)
        .filter_map(|i| {
            let rank = if count > 1 { i * (n - 1) / (count - 1) } else { 0 };
            order.get(rank).map(|view| RankedView { rank, view })
        })
        .collect()
}

/// Returns the longest side such that `pictures` of this shape stay within `budget` bytes.
fn side_px(image: &Image, pictures: usize, budget: usize, limits: RangeInclusive<usize>) -> usize {
    let pixels = budget as f64 / BYTES_PER_PIXEL / pictures.max(1) as f64;
    let (long, short) = (image.width.max(image.height).max(1) as f64, image.width.min(image.height).max(1) as f64);
    ((pixels * long / short).sqrt() as usize).clamp(*limits.start(), *limits.end())
}

fn error_scale(input: &ReportInput) -> f32 {
    let total: usize = input.views.iter().map(|view| view.target.pixels.len()).sum();
    let stride = total.div_ceil(1 << 18).max(1);
    let mut errors = Vec::new();
    for view in &input.views {
        let pairs = view.prediction.pixels.iter().zip(&view.target.pixels).enumerate().step_by(stride);
        let valid = pairs.filter(|(i, _)| luxel_core::mask::is_valid(view.mask.as_deref(), *i));
        errors.extend(valid.map(|(_, (&p, &t))| mu_error(p, t, input.mu)).filter(|e| e.is_finite()));
    }
    errors.sort_by(f32::total_cmp);
    let high = errors.get(errors.len() * 995 / 1000).copied().unwrap_or(0.0);
    ERROR_SCALES.into_iter().find(|&scale| scale >= high).unwrap_or(1.0)
}

impl Gallery<'_> {
    fn display(&self, tonemap: Tonemap, exposure_ev: f32, max_side_px: usize) -> Display {
        Display { tonemap, exposure_ev, color_space: self.input.color_space, max_side_px }
    }

    fn hero(&self, view: &ReportView) -> Result<String> {
        let ev = self.exposures.overview_ev;
        let display = self.display(Tonemap::Agx, ev, 820);
        let (render, target) = (radiance(&view.prediction, &display)?, radiance(&view.target, &display)?);
        let name = escape(&view.name);
        Ok(format!(
            "<div class=\"wipe\">{}{}<input type=\"range\" min=\"0\" max=\"100\" step=\"0.5\" value=\"50\" aria-label=\"wipe between render and ground truth\" \
             oninput=\"this.parentNode.style.setProperty('--x',this.value+'%')\"><div class=\"edge\"></div><span class=\"left\">render</span>\
             <span class=\"right\">ground truth</span></div><p class=\"note under\">View {name}, not used in training, tone-mapped with AgX at {} EV. Drag to compare.</p>\n",
            img(&render, "", &format!("render of {name}")),
            img(&target, "over", &format!("ground truth of {name}")),
            signed(ev),
        ))
    }

    fn featured(&self, featured: &[RankedView<'_>]) -> Result<String> {
        let mut out = format!(
            "<section><h2>Views</h2><p>{} Under the mu-law, as in papers; then at two exposures in sRGB without a tone curve: {} EV for the shadows, {} EV \
             for the lamps. A scene in high dynamic range has to hold at both.</p>",
            if self.input.views.len() > featured.len() { "From the worst to the best." } else { "" },
            signed(self.exposures.shadows_ev),
            signed(self.exposures.lamps_ev),
        );
        out += &self.legend();
        for &RankedView { rank, view } in featured {
            let side = side_px(&view.target, featured.len() * FEATURED_PICTURES, FEATURED_BUDGET_BYTES, FEATURED_SIDES_PX);
            out += &self.featured_view(view, self.rank(rank), side)?;
        }
        Ok(out + "</section>\n")
    }

    /// Returns a remark on a view's rank.
    fn rank(&self, rank: usize) -> &'static str {
        match (rank, self.input.views.len()) {
            (_, 1) => "",
            (0, _) => " · worst",
            (rank, n) if rank + 1 == n => " · best",
            _ => "",
        }
    }

    fn featured_view(&self, view: &ReportView, remark: &str, side: usize) -> Result<String> {
        let (p, t) = (&view.prediction, &view.target);
        let mulaw = self.display(Tonemap::Mulaw, 0.0, side);
        let shadows = self.display(Tonemap::None, self.exposures.shadows_ev, side);
        let lamps = self.display(Tonemap::None, self.exposures.lamps_ev, side);
        let (shadows_ev, lamps_ev) = (signed(self.exposures.shadows_ev), signed(self.exposures.lamps_ev));
        let mut out = format!(
            "<h3>{} <span class=\"soft\">{}{remark}</span></h3><div class=\"row three\">",
            escape(&view.name),
            metrics_line(&view.metrics)
        );
        out += &figure(&radiance(p, &mulaw)?, "render", "mu-law");
        out += &figure(&radiance(t, &mulaw)?, "ground truth", "mu-law");
        out += &figure(&self.error(view, side)?, "error", "mu-law difference");
        out += "</div><div class=\"row four\">";
        for (display, ev) in [(&shadows, &shadows_ev), (&lamps, &lamps_ev)] {
            out += &figure(&radiance(p, display)?, "render", &format!("{ev} EV"));
            out += &figure(&radiance(t, display)?, "ground truth", &format!("{ev} EV"));
        }
        Ok(out + "</div>\n")
    }

    fn others(&self, others: &[&ReportView]) -> Result<String> {
        if others.is_empty() {
            return Ok(String::new());
        }
        let mut out = String::from(
            "<section><h2>All other views</h2><p class=\"note\">Render, ground truth and error, under the mu-law.</p><div class=\"thumbs\">",
        );
        for view in others {
            let side = side_px(&view.target, others.len() * SMALL_PICTURES, SMALL_BUDGET_BYTES, SMALL_SIDES_PX);
            let mulaw = self.display(Tonemap::Mulaw, 0.0, side);
            let name = escape(&view.name);
            let _ = write!(
                out,
                "<figure><div class=\"row\">{}{}{}</div><figcaption><b>{name}</b> {}</figcaption></figure>",
                img(&radiance(&view.prediction, &mulaw)?, "", &format!("render of {name}")),
                img(&radiance(&view.target, &mulaw)?, "", &format!("ground truth of {name}")),
                img(&self.error(view, side)?, "", &format!("error of {name}")),
                metrics_line(&view.metrics),
            );
        }
        Ok(out + "</div></section>\n")
    }

    fn error(&self, view: &ReportView, side: usize) -> Result<Picture> {
        error_map(&view.prediction, &view.target, view.mask.as_deref(), self.input.mu, self.error_scale, side)
    }

    /// Returns the legend of the error map. Well above 1/mu, a difference d of the mu-law is a
    /// ratio of (1 + mu)^d.
    fn legend(&self) -> String {
        let colors = INFERNO.map(|[r, g, b]| format!("#{r:02x}{g:02x}{b:02x}")).join(",");
        let stops_per_unit = (1.0 + f64::from(self.input.mu)).log2();
        let marks = [0.0, 0.25, 0.5, 0.75, 1.0].map(|share| {
            let error = share * f64::from(self.error_scale);
            let stops = if share > 0.0 { format!("{:.2} EV", error * stops_per_unit) } else { "0".into() };
            (if share > 0.0 { plain(error) } else { "0".into() }, stops)
        });
        let cells = |of: &dyn Fn(&(String, String)) -> String| marks.iter().map(|m| format!("<span>{}</span>", of(m))).collect::<String>();
        format!(
            "<div class=\"legend\"><div>error: mean difference of the channels under the mu-law</div>\
             <div class=\"ramp\" style=\"background:linear-gradient(90deg,{colors})\"></div><div class=\"marks\">{}</div><div class=\"marks\">{}</div></div>",
            cells(&|m| m.0.clone()),
            cells(&|m| m.1.clone()),
        )
    }
}

fn metrics_line(m: &ViewMetrics) -> String {
    format!("{:.2} dB, SSIM {:.3} (scene) · {:.2} dB (gtmax)", m.psnr_scene, m.ssim_scene, m.psnr_gtmax)
}

fn plain(value: f64) -> String {
    let text = format!("{value:.4}");
    text.trim_end_matches('0').trim_end_matches('.').to_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pictures_shrink_to_the_budget_and_no_further_than_they_must() {
        for (width, height, pictures) in [(400, 400, 28), (2016, 1512, 28), (1512, 2016, 600)] {
            let image = Image { width, height, pixels: Vec::new() };
            let side = side_px(&image, pictures, 4_500_000, 16..=640);
            let pixels = (side * side) as f64 * width.min(height) as f64 / width.max(height) as f64;
            let bytes = pixels * BYTES_PER_PIXEL * pictures as f64;
            assert!(bytes <= 4_500_000.0 && (bytes > 4_300_000.0 || side == 640), "{width}x{height}: {side} px, {bytes} bytes");
        }
        assert_eq!(side_px(&Image::default(), 0, 1000, 16..=640), 22);
        let thread = Image { width: 1, height: 100_000, pixels: Vec::new() };
        assert_eq!(side_px(&thread, 28, 4_500_000, 16..=640), 640);
    }

    #[test]
    fn featured_views_run_from_the_worst_to_the_best() {
        let views: Vec<ReportView> = (0..9)
            .map(|i| ReportView {
                name: i.to_string(),
                prediction: Image::default(),
                target: Image::default(),
                mask: None,
                metrics: ViewMetrics::default(),
            })
            .collect();
        let order: Vec<&ReportView> = views.iter().collect();
        let ranks = |n: usize, count| spread(&order[..n], count).into_iter().map(|ranked| ranked.rank).collect::<Vec<_>>();
        assert_eq!(ranks(9, 4), [0, 2, 5, 8]);
        assert_eq!(ranks(3, 4), [0, 1, 2]);
        assert_eq!((ranks(1, 4), ranks(0, 4)), (vec![0], vec![]));
    }
}
