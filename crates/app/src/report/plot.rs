//! Line plots as inline SVG. Colours are classes of the page's style sheet, so plots follow the
//! reader's light or dark theme.
//!
//! In: series of points in data units. Out: one `svg` element, or nothing if no series has a point
//! that can be shown. Points that are not finite, or not positive on a logarithmic axis, are left
//! out.

use std::fmt::Write as _;

use super::html::escape;

const WIDTH: f64 = 440.0;
const HEIGHT: f64 = 270.0;
const LEFT: f64 = 50.0;
const RIGHT: f64 = 14.0;
const TOP: f64 = 12.0;
const BOTTOM: f64 = 42.0;

/// Number of colours in the style sheet.
const COLORS: usize = 8;

/// The scale of an axis.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Scale {
    Linear,
    Log,
}

/// An axis.
#[derive(Clone, Copy, Debug)]
pub(super) struct Axis<'a> {
    pub(super) label: &'a str,
    pub(super) scale: Scale,
}

/// The style of a series.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Mark {
    /// A line.
    Line,
    /// A thin line in the background.
    Faint,
    /// A line with a dot at each point.
    Dots,
    /// A dashed line that does not stretch the axes.
    Guide,
}

/// A point in data units, or in the drawing's.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Point {
    pub(super) x: f64,
    pub(super) y: f64,
}

/// A bar in the background.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Bar {
    /// Its ends along x.
    pub(super) from: f64,
    pub(super) to: f64,
    /// Its height, 0 to 1.
    pub(super) share: f64,
}

/// Points of one colour.
#[derive(Clone, Debug)]
pub(super) struct Series {
    /// Text in the legend; empty for none.
    pub(super) label: String,
    /// From 1: which of the page's [`COLORS`], again and dashed beyond them. Guides have their own.
    pub(super) color: usize,
    pub(super) mark: Mark,
    pub(super) points: Vec<Point>,
}

/// A plot.
#[derive(Clone, Debug)]
pub(super) struct Plot<'a> {
    pub(super) title: &'a str,
    pub(super) x: Axis<'a>,
    pub(super) y: Axis<'a>,
    pub(super) series: Vec<Series>,
    /// Drawn behind everything, for how much data there is.
    pub(super) bars: Vec<Bar>,
}

impl Plot<'_> {
    /// Returns a `figure` element; `None` if there is nothing to draw.
    pub(super) fn figure(&self) -> Option<String> {
        let frame = Frame::new(self)?;
        let mut svg = format!("<svg viewBox=\"0 0 {WIDTH} {HEIGHT}\" role=\"img\" aria-label=\"{}\">", escape(self.title));
        for bar in &self.bars {
            frame.bar(&mut svg, *bar);
        }
        frame.grid(&mut svg, self);
        for series in &self.series {
            frame.series(&mut svg, series);
        }
        svg += "</svg>";
        let mut legend = String::new();
        let is_listed = |s: &&Series| !s.label.is_empty() && s.mark != Mark::Guide && frame.has_point(s);
        for series in self.series.iter().filter(is_listed) {
            let _ = write!(legend, "<span class=\"key {}\">{}</span>", color_class(series.color), escape(&series.label));
        }
        Some(format!("<figure class=\"plot\"><figcaption><b>{}</b>{legend}</figcaption>{svg}</figure>", escape(self.title)))
    }
}

/// Returns the classes of a colour in the style sheet.
fn color_class(color: usize) -> String {
    let i = color.saturating_sub(1);
    format!("c{}{}", i % COLORS + 1, if i < COLORS { "" } else { " again" })
}

/// Axis limits, and the map from data to the drawing.
struct Frame {
    x: Span,
    y: Span,
}

/// Limits of one axis, in the scale's own units (log10 for logarithmic).
#[derive(Clone, Copy)]
struct Span {
    scale: Scale,
    low: f64,
    high: f64,
}

impl Span {
    fn new(scale: Scale, values: impl Iterator<Item = f64>) -> Option<Self> {
        let placed = values.filter_map(|v| place(scale, v));
        let (low, high) = placed.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), v| (low.min(v), high.max(v)));
        (low <= high).then_some(Self { scale, low, high })
    }

    /// Adds room on both sides; the length is never 0.
    fn padded(self, share: f64) -> Self {
        let room = (self.high - self.low) * share;
        let room = if room > 0.0 {
            room
        } else if self.scale == Scale::Log {
            0.5
        } else {
            (self.high.abs() * 0.1).max(1e-6)
        };
        Self { low: self.low - room, high: self.high + room, ..self }
    }

    /// Returns 0 at the lower limit, 1 at the upper; `None` if the value has no place on the axis.
    fn share(self, value: f64) -> Option<f64> {
        place(self.scale, value).map(|v| (v - self.low) / (self.high - self.low))
    }

    /// Returns values with a tick, and their texts.
    fn ticks(self, most: usize) -> Vec<(f64, String)> {
        match self.scale {
            Scale::Linear => linear_ticks(self.low, self.high, most),
            Scale::Log => log_ticks(self.low, self.high, most),
        }
    }
}

fn place(scale: Scale, value: f64) -> Option<f64> {
    let placed = if scale == Scale::Log { value.log10() } else { value };
    placed.is_finite().then_some(placed)
}

/// Returns multiples of 1, 2 or 5 times a power of ten.
fn linear_ticks(low: f64, high: f64, most: usize) -> Vec<(f64, String)> {
    let raw = (high - low) / most as f64;
    let decade = 10f64.powf(raw.log10().floor());
    let step = [1.0, 2.0, 5.0, 10.0].into_iter().map(|m| m * decade).find(|&s| s >= raw).unwrap_or(raw);
    let first = (low / step).ceil() as i64;
    (first..).map(|i| i as f64 * step).take_while(|&v| v <= high).take(2 * most + 2).map(|v| (v, short(v, step))).collect()
}

/// Returns powers of ten, every second or third where there are many; 1, 2 and 5 where there is
/// hardly one.
fn log_ticks(low: f64, high: f64, most: usize) -> Vec<(f64, String)> {
    let decades: Vec<i32> = ((low.ceil() as i32)..=(high.floor() as i32)).collect();
    if decades.len() < 2 {
        let from = low.floor() as i32;
        let values = (from..=high.ceil() as i32).flat_map(|d| [1.0, 2.0, 5.0].map(|m| m * 10f64.powi(d)));
        return values.filter(|v| (low..=high).contains(&v.log10())).map(|v| (v, short(v, v))).collect();
    }
    let every = decades.len().div_ceil(most).max(1) as i32;
    decades.into_iter().filter(|d| d.rem_euclid(every) == 0).map(|d| (10f64.powi(d), power_of_ten(d))).collect()
}

fn power_of_ten(exponent: i32) -> String {
    match exponent {
        0 => "1".into(),
        1..=3 => 10f64.powi(exponent).to_string(),
        -2 | -1 => format!("{:.*}", exponent.unsigned_abs() as usize, 10f64.powi(exponent)),
        _ => {
            let digits = exponent.to_string();
            let superscript = digits.chars().map(|c| match c {
                '-' => '⁻',
                '1' => '¹',
                '2' => '²',
                '3' => '³',
                c => char::from_u32(0x2070 + c.to_digit(10).unwrap_or(0)).unwrap_or(c),
            });
            format!("10{}", superscript.collect::<String>())
        }
    }
}

/// Returns a tick's text: no more decimals than `step` needs, thousands as k.
fn short(value: f64, step: f64) -> String {
    let (value, step, unit) = match value.abs().max(step) {
        v if v >= 1e6 => (value / 1e6, step / 1e6, "M"),
        v if v >= 1e4 => (value / 1e3, step / 1e3, "k"),
        _ => (value, step, ""),
    };
    if value == 0.0 {
        return "0".into();
    }
    let decimals = (-step.abs().log10() - 1e-9).ceil().clamp(0.0, 8.0) as usize;
    format!("{value:.decimals$}{unit}")
}

impl Frame {
    fn new(plot: &Plot<'_>) -> Option<Self> {
        let shown = || {
            let stretching = plot.series.iter().filter(|s| s.mark != Mark::Guide);
            stretching
                .flat_map(|s| s.points.iter().copied())
                .filter(|point| place(plot.x.scale, point.x).is_some() && place(plot.y.scale, point.y).is_some())
        };
        let x = Span::new(plot.x.scale, shown().map(|point| point.x))?;
        let y = Span::new(plot.y.scale, shown().map(|point| point.y))?.padded(0.06);
        Some(Self { x: if x.low < x.high { x } else { x.padded(0.0) }, y })
    }

    /// Returns the place of a point in the drawing.
    fn point(&self, point: Point) -> Option<Point> {
        let (x, y) = (self.x.share(point.x)?, self.y.share(point.y)?);
        Some(Point { x: LEFT + x * (WIDTH - LEFT - RIGHT), y: HEIGHT - BOTTOM - y * (HEIGHT - TOP - BOTTOM) })
    }

    /// Returns whether a point of a series has a place in the drawing.
    fn has_point(&self, series: &Series) -> bool {
        series.points.iter().any(|point| self.point(*point).is_some())
    }

    fn bar(&self, svg: &mut String, Bar { from, to, share }: Bar) {
        let (Some(a), Some(b)) = (self.x.share(from), self.x.share(to)) else { return };
        let (a, b) = (a.clamp(0.0, 1.0), b.clamp(0.0, 1.0));
        if b <= a || share.is_nan() || share <= 0.0 {
            return;
        }
        let width = WIDTH - LEFT - RIGHT;
        let height = share.min(1.0) * (HEIGHT - TOP - BOTTOM);
        let (x, y) = (LEFT + a * width, HEIGHT - BOTTOM - height);
        let _ = write!(svg, "<rect class=\"bar\" x=\"{x:.1}\" y=\"{y:.1}\" width=\"{:.1}\" height=\"{height:.1}\"/>", (b - a) * width);
    }

    fn grid(&self, svg: &mut String, plot: &Plot<'_>) {
        let (right, bottom) = (WIDTH - RIGHT, HEIGHT - BOTTOM);
        for (value, text) in self.y.ticks(5) {
            if let Some(share) = self.y.share(value) {
                let y = bottom - share * (bottom - TOP);
                let _ = write!(svg, "<line class=\"grid\" x1=\"{LEFT}\" x2=\"{right}\" y1=\"{y:.1}\" y2=\"{y:.1}\"/>");
                let _ = write!(svg, "<text class=\"tick end\" x=\"{}\" y=\"{:.1}\">{text}</text>", LEFT - 6.0, y + 4.0);
            }
        }
        for (value, text) in self.x.ticks(6) {
            if let Some(share) = self.x.share(value) {
                let x = LEFT + share * (right - LEFT);
                let _ = write!(svg, "<line class=\"notch\" x1=\"{x:.1}\" x2=\"{x:.1}\" y1=\"{bottom}\" y2=\"{}\"/>", bottom + 4.0);
                let _ = write!(svg, "<text class=\"tick mid\" x=\"{x:.1}\" y=\"{}\">{text}</text>", bottom + 17.0);
            }
        }
        let _ = write!(svg, "<line class=\"axis\" x1=\"{LEFT}\" x2=\"{right}\" y1=\"{bottom}\" y2=\"{bottom}\"/>");
        let _ =
            write!(svg, "<text class=\"label mid\" x=\"{}\" y=\"{}\">{}</text>", (LEFT + right) / 2.0, HEIGHT - 5.0, escape(plot.x.label));
        let (x, y) = (12.0, (TOP + bottom) / 2.0);
        let _ =
            write!(svg, "<text class=\"label mid\" transform=\"rotate(-90 {x} {y})\" x=\"{x}\" y=\"{y}\">{}</text>", escape(plot.y.label));
    }

    fn series(&self, svg: &mut String, series: &Series) {
        let points: Vec<Point> = series.points.iter().filter_map(|&p| self.point(p)).collect();
        let class = match series.mark {
            Mark::Line | Mark::Dots => format!("line {}", color_class(series.color)),
            Mark::Faint => format!("faint {}", color_class(series.color)),
            Mark::Guide => "guide".into(),
        };
        if series.mark == Mark::Guide {
            return self.guide(svg, series, &points);
        }
        if points.len() > 1 {
            let _ = write!(svg, "<polyline class=\"{class}\" points=\"");
            for Point { x, y } in &points {
                let _ = write!(svg, "{x:.1},{y:.1} ");
            }
            *svg += "\"/>";
        }
        if series.mark == Mark::Dots || points.len() == 1 {
            for Point { x, y } in &points {
                let _ = write!(svg, "<circle class=\"dot {}\" cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"3\"/>", color_class(series.color));
            }
        }
    }

    /// Draws a straight line from the first to the last point, cut at the frame, with its label at
    /// the upper end.
    fn guide(&self, svg: &mut String, series: &Series, points: &[Point]) {
        let (Some(&Point { x: x0, y: y0 }), Some(&Point { x: x1, y: y1 })) = (points.first(), points.last()) else { return };
        let (top, bottom) = (TOP, HEIGHT - BOTTOM);
        let at = |y: f64| if y1 == y0 { 0.0 } else { (y - y0) / (y1 - y0) };
        // Both ends in terms of the line's own parameter, clipped to the frame's top and bottom.
        let (a, b) = (at(top).min(at(bottom)).max(0.0), at(top).max(at(bottom)).min(1.0));
        if a >= b || y1 == y0 {
            return;
        }
        let end = |t: f64| (x0 + t * (x1 - x0), y0 + t * (y1 - y0));
        let ((ax, ay), (bx, by)) = (end(a), end(b));
        let _ = write!(svg, "<line class=\"guide\" x1=\"{ax:.1}\" y1=\"{ay:.1}\" x2=\"{bx:.1}\" y2=\"{by:.1}\"/>");
        let _ = write!(svg, "<text class=\"halo end\" x=\"{:.1}\" y=\"{:.1}\">{}</text>", bx - 6.0, by + 10.0, escape(&series.label));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn plot(points: &[[f64; 2]], scale: Scale) -> Plot<'static> {
        let points = points.iter().map(|&[x, y]| Point { x, y }).collect();
        let series = vec![Series { label: "a<b".into(), color: 1, mark: Mark::Dots, points }];
        Plot { title: "t & t", x: Axis { label: "x", scale: Scale::Linear }, y: Axis { label: "y", scale }, series, bars: Vec::new() }
    }

    #[test]
    fn ticks_are_round_and_within_the_axis() {
        let texts = |ticks: Vec<(f64, String)>| ticks.into_iter().map(|(_, text)| text).collect::<Vec<_>>();
        assert_eq!(texts(linear_ticks(0.0, 30_000.0, 6)), ["0", "5000", "10k", "15k", "20k", "25k", "30k"]);
        assert_eq!(texts(linear_ticks(21.3, 38.9, 5)), ["25", "30", "35"]);
        assert_eq!(texts(linear_ticks(0.011, 0.019, 5)), ["0.012", "0.014", "0.016", "0.018"]);
        assert_eq!(texts(log_ticks(-4.2, 2.9, 8)), ["10⁻⁴", "10⁻³", "0.01", "0.1", "1", "10", "100"]);
        assert_eq!(texts(log_ticks(-1.2, -0.1, 5)), ["0.1", "0.2", "0.5"]);
    }

    #[test]
    fn points_without_a_place_are_left_out() {
        let figure = plot(&[[0.0, 1.0], [1.0, f64::NAN], [2.0, -3.0], [3.0, 100.0]], Scale::Log).figure().unwrap();
        assert_eq!(figure.matches("<circle").count(), 2);
        assert!(!figure.contains("NaN") && !figure.contains("inf"), "{figure}");
        assert!(figure.contains("t &amp; t") && figure.contains("a&lt;b"));
    }

    #[test]
    fn the_legend_has_no_entry_without_points() {
        let mut plot = plot(&[[0.0, 1.0], [1.0, 2.0]], Scale::Log);
        for (label, points) in [("nothing", vec![]), ("nowhere", vec![Point { x: 1.0, y: -1.0 }, Point { x: 2.0, y: f64::NAN }])] {
            plot.series.push(Series { label: label.into(), color: 2, mark: Mark::Line, points });
        }
        let figure = plot.figure().unwrap();
        assert!(figure.contains("a&lt;b") && !figure.contains("nothing") && !figure.contains("nowhere"), "{figure}");
    }

    #[test]
    fn colours_beyond_the_last_come_again_dashed() {
        assert_eq!([1, 8, 9, 18].map(color_class), ["c1", "c8", "c1 again", "c2 again"]);
    }

    #[test]
    fn a_plot_of_nothing_is_nothing_and_of_one_point_a_dot() {
        assert!(plot(&[], Scale::Linear).figure().is_none());
        assert!(plot(&[[1.0, 0.0]], Scale::Log).figure().is_none());
        for scale in [Scale::Linear, Scale::Log] {
            let figure = plot(&[[5.0, 5.0]], scale).figure().unwrap();
            assert!(figure.contains("<circle") && !figure.contains("NaN"), "{figure}");
        }
    }
}
