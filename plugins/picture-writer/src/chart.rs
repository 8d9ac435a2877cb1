//! Curves over time as a picture: axes with ticks and labels, a grid, a legend.
//!
//! Invariant: any numbers give a picture: without points the axes are empty, points that are not finite are
//! gaps, and what lies beyond a given range is drawn at its edge.

use std::ops::Range;

use plotters::prelude::*;

use crate::canvas::Canvas;
use crate::file::Picture;
use crate::traces::thinned;

/// Colours that people with any vision tell apart (Okabe and Ito, "Color Universal Design", 2008).
const COLORS: [RGBColor; 4] =
    [RGBColor(0, 114, 178), RGBColor(213, 94, 0), RGBColor(0, 158, 115), RGBColor(204, 121, 167)];
/// Letters, px; the title's are larger.
const LETTERS: (&str, u32) = ("mono", 16);
const TITLE: (&str, u32) = ("mono", 24);
/// Share of the range that is left free above and below.
const MARGIN: f64 = 0.05;
/// Larger numbers are gaps: their differences would be infinite.
const LARGEST: f64 = 1e100;
/// Narrowest vertical axis for its numbers' size: ticks closer together are not different doubles.
const NARROWEST: f64 = 1e-9;

/// One curve.
pub(crate) struct Curve {
    pub(crate) label: String,
    /// Time in s and value.
    pub(crate) points: Vec<(f64, f64)>,
}

/// A chart to be drawn.
pub(crate) struct Chart {
    pub(crate) title: String,
    pub(crate) y_label: String,
    /// px.
    pub(crate) width: u32,
    /// px.
    pub(crate) height: u32,
    /// Ends of the vertical axis; where there is none, the curves decide.
    pub(crate) y_min: Option<f64>,
    pub(crate) y_max: Option<f64>,
    pub(crate) curves: Vec<Curve>,
}

/// Draws it.
///
/// # Errors
/// The drawing library's sentence.
pub(crate) fn draw(chart: &Chart) -> Result<Picture, String> {
    let pixels = 3 * chart.width as usize * chart.height as usize;
    let mut picture = Picture { width: chart.width, height: chart.height, rgb: vec![255; pixels] };
    draw_on(Canvas(&mut picture), chart).map_err(|why| format!("the plot cannot be drawn: {why}"))?;
    Ok(picture)
}

fn draw_on<DB: DrawingBackend>(canvas: DB, chart: &Chart) -> Result<(), DrawingAreaErrorKind<DB::ErrorType>> {
    let area = canvas.into_drawing_area();
    let mut builder = ChartBuilder::on(&area);
    builder.margin(12).margin_right(24).x_label_area_size(48).y_label_area_size(88);
    if !chart.title.is_empty() {
        builder.caption(&chart.title, TITLE);
    }
    let range = values(chart);
    let mut axes = builder.build_cartesian_2d(times(chart), range.clone())?;
    let mesh_labels = (chart.width / 110).clamp(2, 12) as usize;
    axes.configure_mesh()
        .x_desc("t / s")
        .y_desc(&chart.y_label)
        .x_labels(mesh_labels)
        .y_labels((chart.height / 60).clamp(2, 12) as usize)
        .label_style(LETTERS)
        .axis_desc_style(LETTERS)
        .light_line_style(WHITE)
        .bold_line_style(RGBColor(215, 215, 215))
        .draw()?;
    for (curve, color) in chart.curves.iter().zip(COLORS) {
        let points = thinned(&curve.points, chart.width as usize);
        let mut label = Some(curve.label.as_str());
        // A curve without points has a line in the legend, too: it was asked for.
        let parts = points.split(|point| !is_drawn(point.1)).filter(|part| !part.is_empty());
        for part in parts.chain([&[][..]]) {
            let within = part.iter().map(|(t, value)| (*t, value.clamp(range.start, range.end)));
            let drawn = axes.draw_series(LineSeries::new(within, color.stroke_width(1)))?;
            if let Some(label) = label.take() {
                drawn
                    .label(label)
                    .legend(move |(x, y)| Rectangle::new([(x, y - 1), (x + 20, y + 1)], color.filled()));
            }
        }
    }
    let background = WHITE.mix(0.85);
    axes.configure_series_labels()
        .position(SeriesLabelPosition::UpperRight)
        .background_style(background)
        .border_style(RGBColor(160, 160, 160))
        .label_font(LETTERS)
        .draw()?;
    drop(axes);
    area.present()
}

/// The horizontal axis.
fn times(chart: &Chart) -> Range<f64> {
    let all = || chart.curves.iter().flat_map(|curve| &curve.points).map(|point| point.0);
    let (first, last) = (all().fold(f64::INFINITY, f64::min), all().fold(f64::NEG_INFINITY, f64::max));
    if last > first { first..last } else { widened(first, last) }
}

/// The vertical axis.
fn values(chart: &Chart) -> Range<f64> {
    let all =
        || chart.curves.iter().flat_map(|curve| &curve.points).map(|point| point.1).filter(|v| is_drawn(*v));
    let (low, high) = (all().fold(f64::INFINITY, f64::min), all().fold(f64::NEG_INFINITY, f64::max));
    let room = if high > low { (high - low) * MARGIN } else { 0.0 };
    let given = |end: Option<f64>| end.filter(|end| is_drawn(*end));
    let (y_min, y_max) = (given(chart.y_min), given(chart.y_max));
    let (low, high) = (y_min.unwrap_or(low - room), y_max.unwrap_or(high + room));
    if high - low > NARROWEST * low.abs().max(high.abs()) && (high - low).is_finite() {
        return low..high;
    }
    // One end is given and the curves lie beyond it, or all is one value.
    match (y_min, y_max) {
        (Some(low), None) => low..widened(low, low).end,
        (None, Some(high)) => widened(high, high).start..high,
        _ => widened(low, high),
    }
}

/// Whether a value has a place in a picture.
fn is_drawn(value: f64) -> bool {
    value.abs() <= LARGEST
}

/// A range around a single value, or any one where there is none.
fn widened(low: f64, high: f64) -> Range<f64> {
    if !is_drawn(low) || !is_drawn(high) {
        return 0.0..1.0;
    }
    let room = (low.abs() * 0.1).max(1e-9);
    low - room..high + room
}

#[cfg(test)]
#[path = "chart_tests.rs"]
mod tests;
