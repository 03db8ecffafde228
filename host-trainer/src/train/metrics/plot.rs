//! `loss.svg`: the course of loss and errors.

use std::io::Write;
use std::path::Path;

use plotters::coord::Shift;
use plotters::prelude::*;

use super::MetricLine;
use crate::atomic_file;
use crate::error::{Error, Result};

/// One named curve. // (point)(step, value)
type Curve<'a> = (&'a str, Vec<(f64, f64)>);

/// Draws loss and its parts above, errors in real units below, both with a logarithmic axis.
///
/// # Errors
/// `Io` when the file cannot be written.
pub fn plot_losses(lines: &[MetricLine], path: &Path) -> Result<()> {
    const SIZE_PIXELS: (u32, u32) = (900, 800);
    let mut text = String::new();
    {
        let root = SVGBackend::with_string(&mut text, SIZE_PIXELS).into_drawing_area();
        draw(&root, lines)
            .map_err(|error| Error::io("draw", path)(std::io::Error::other(error.to_string())))?;
    }
    atomic_file::replace(path, |file| file.write_all(text.as_bytes()))
}

fn draw(
    root: &DrawingArea<SVGBackend<'_>, Shift>,
    lines: &[MetricLine],
) -> core::result::Result<(), Box<dyn core::error::Error>> {
    root.fill(&WHITE)?;
    let panels = root.split_evenly((2, 1));
    let curve = |value: fn(&MetricLine) -> f64| {
        lines.iter().map(|line| (line.step as f64, value(line))).collect()
    };
    let losses = [
        ("loss", curve(|line| line.loss)),
        ("reconstruction", curve(|line| line.reconstruction)),
        ("divergence (KL)", curve(|line| line.divergence)),
    ];
    draw_panel(&panels[0], "loss", &losses)?;
    let names = lines.first().map(|line| line.error_rms.keys()).into_iter().flatten();
    let errors: Vec<Curve<'_>> = names
        .map(|name| {
            let value = |line: &MetricLine| line.error_rms.get(name).copied().unwrap_or(f64::NAN);
            (name.as_str(), lines.iter().map(|line| (line.step as f64, value(line))).collect())
        })
        .collect();
    draw_panel(&panels[1], "error, root of mean square per channel", &errors)?;
    root.present()?;
    Ok(())
}

fn draw_panel(
    area: &DrawingArea<SVGBackend<'_>, Shift>,
    title: &str,
    curves: &[Curve<'_>],
) -> core::result::Result<(), Box<dyn core::error::Error>> {
    const FONT: (&str, u32) = ("sans-serif", 16);
    let is_drawable = |point: &&(f64, f64)| point.1.is_finite() && point.1 > 0.0;
    let points = || curves.iter().flat_map(|(_, points)| points).filter(is_drawable);
    let step_max = points().map(|point| point.0).fold(1.0, f64::max);
    let value_min = points().map(|point| point.1).fold(f64::INFINITY, f64::min);
    let value_max = points().map(|point| point.1).fold(0.0, f64::max);
    if value_max == 0.0 {
        return Ok(());
    }
    let mut chart = ChartBuilder::on(area)
        .caption(title, FONT)
        .margin(10)
        .x_label_area_size(30)
        .y_label_area_size(70)
        .build_cartesian_2d(0.0..step_max, (0.9 * value_min..1.1 * value_max).log_scale())?;
    chart
        .configure_mesh()
        .x_desc("step")
        .y_label_formatter(&|value| format!("{value:.3e}"))
        .draw()?;
    for (index, (name, points)) in curves.iter().enumerate() {
        let color = Palette99::pick(index).to_rgba();
        let drawn = points.iter().filter(is_drawable).copied();
        chart
            .draw_series(LineSeries::new(drawn, color))?
            .label(*name)
            .legend(move |(x, y)| PathElement::new([(x, y), (x + 20, y)], color));
    }
    chart.configure_series_labels().background_style(WHITE).border_style(BLACK).draw()?;
    Ok(())
}
