//! A performance at a glance: a minute of every servo, and the whole of it minute by minute.
//!
//! In:  a [`Performance`], names of the servos.
//! Out: SVG.

use plotters::prelude::*;

use super::{Performance, Tick};

/// Seconds of the course that is drawn whole.
const COURSE_S: f64 = 60.0;
/// Instants of it a second.
const COURSE_HZ: f64 = 20.0;

/// Draws the picture.
///
/// # Errors
/// What the drawing library says.
pub fn draw(performance: &Performance, names: &[String]) -> Result<String, String> {
    let mut svg = String::new();
    let height = 90 * names.len() as u32 + 220;
    {
        let root = SVGBackend::with_string(&mut svg, (1000, height)).into_drawing_area();
        let drawn = root.fill(&WHITE).map_err(|error| error.to_string());
        drawn?;
        let (course, hour) = root.split_vertically(height - 220);
        let rows = course.split_evenly((names.len().max(1), 1));
        for (servo, (row, name)) in rows.iter().zip(names).enumerate() {
            draw_servo(row, performance, servo, name).map_err(|error| error.to_string())?;
        }
        draw_minutes(&hour, performance).map_err(|error| error.to_string())?;
        root.present().map_err(|error| error.to_string())?;
    }
    Ok(svg)
}

type Area<'a> = DrawingArea<SVGBackend<'a>, plotters::coord::Shift>;
type Drawn<'a> = Result<(), Box<dyn std::error::Error + 'a>>;

/// One servo: what it is told, and where its horn is.
fn draw_servo<'a>(
    area: &Area<'a>,
    performance: &Performance,
    servo: usize,
    name: &str,
) -> Drawn<'a> {
    let step = (1e6 / f64::from(performance.stint.tick_us) / COURSE_HZ).max(1.0) as usize;
    let course = performance.ticks.iter().take_while(|tick| tick.time_s <= COURSE_S);
    let course: Vec<&Tick> = course.step_by(step).collect();
    let told =
        course.iter().filter_map(|tick| Some((tick.time_s, f64::from(tick.pulses_us[servo]?))));
    let told: Vec<(f64, f64)> = told.collect();
    let horn = course.iter().map(|tick| (tick.time_s, tick.horns_us[servo]));
    let all = told.iter().map(|(_, us)| *us).chain(horn.clone().map(|(_, us)| us));
    let (min, max) =
        all.fold((f64::INFINITY, f64::NEG_INFINITY), |(min, max), us| (us.min(min), us.max(max)));
    let (min, max) = if min < max { (min - 10.0, max + 10.0) } else { (1400.0, 1600.0) };
    let mut chart = ChartBuilder::on(area)
        .caption(format!("{name}, us: told (blue), horn (orange)"), ("sans-serif", 12))
        .margin(4)
        .x_label_area_size(14)
        .y_label_area_size(44)
        .build_cartesian_2d(0.0..COURSE_S, min..max)?;
    chart.configure_mesh().light_line_style(WHITE).y_labels(4).draw()?;
    chart.draw_series(LineSeries::new(horn, RGBColor(230, 140, 30).stroke_width(2)))?;
    chart.draw_series(LineSeries::new(told, RGBColor(40, 90, 200)))?;
    Ok(())
}

/// Share of every minute in which the body moves by itself, and in which a limit held it.
fn draw_minutes<'a>(area: &Area<'a>, performance: &Performance) -> Drawn<'a> {
    let minutes = performance.ticks.last().map_or(0.0, |tick| tick.time_s / 60.0).ceil().max(1.0);
    let mut sums = vec![[0usize; 3]; minutes as usize];
    for tick in &performance.ticks {
        let minute = ((tick.time_s / 60.0) as usize).min(sums.len() - 1);
        let [count, moving, limited] = &mut sums[minute];
        *count += 1;
        *moving += usize::from(tick.in_motion);
        *limited += usize::from(tick.limited != 0);
    }
    let share = |part: usize| {
        let sums = sums.clone();
        sums.into_iter()
            .enumerate()
            .map(move |(minute, of)| (minute as f64 + 0.5, of[part] as f64 / of[0].max(1) as f64))
    };
    let mut chart = ChartBuilder::on(area)
        .caption(
            "share of each minute in motion (blue), held back by a limit (red)",
            ("sans-serif", 13),
        )
        .margin(6)
        .x_label_area_size(34)
        .y_label_area_size(44)
        .build_cartesian_2d(0.0..minutes, 0.0..1.0)?;
    chart.configure_mesh().light_line_style(WHITE).x_desc("minute").draw()?;
    chart.draw_series(LineSeries::new(share(1), RGBColor(40, 90, 200).stroke_width(2)))?;
    chart.draw_series(LineSeries::new(share(2), RED.stroke_width(2)))?;
    Ok(())
}
