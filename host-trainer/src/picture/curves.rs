//! Contact sheet of servos: one small panel a channel, one coloured curve a motion.
//!
//! In:  motions of any layout (from `picture`).
//! Out: SVG.
//!
//! Rotations are drawn as rotation vectors in degrees, which a reader can picture, and not as
//! matrix elements.

use crate::body::rotation::Rotation;
use crate::export::Motion;
use crate::layout::{Group, GroupKind, PoseLayout};
use crate::picture::svg::{Anchor, FAINT, INK, PALETTE, Point, Svg, TextStyle, ticks};

const MARGIN: f64 = 28.0;
const HEADER_HEIGHT: f64 = 64.0;
const LEGEND_ROW_HEIGHT: f64 = 18.0;
const LEGEND_ENTRY_WIDTH: f64 = 170.0;
const COLUMN_COUNT_MAX: usize = 3;
const PANEL_WIDTH: f64 = 360.0;
const PANEL_HEIGHT: f64 = 150.0;
/// Room for tick labels left of a panel's frame, for its name above and for seconds below.
const PANEL_INSET: (f64, f64, f64) = (44.0, 26.0, 22.0);

/// A curve whose range is a smaller part of its value is drawn as a level, not as its rounding
/// noise.
const FLAT_RANGE: f64 = 1e-4;

/// One panel: a name with its unit, and a curve a motion. // (motion, frame)
struct Panel {
    name: String,
    curves: Vec<Vec<f64>>,
}

/// Draws all channels of all motions.
pub fn draw(motions: &[Motion], title: &str) -> String {
    let panels = panels(motions);
    let column_count = panels.len().clamp(1, COLUMN_COUNT_MAX);
    let row_count = panels.len().div_ceil(column_count);
    let width = 2.0 * MARGIN + column_count as f64 * PANEL_WIDTH;
    let legend_columns = (((width - 2.0 * MARGIN) / LEGEND_ENTRY_WIDTH) as usize).max(1);
    let legend_height = motions.len().div_ceil(legend_columns) as f64 * LEGEND_ROW_HEIGHT;
    let top = HEADER_HEIGHT + legend_height;
    let mut svg = Svg::new(width, top + row_count as f64 * PANEL_HEIGHT + MARGIN);
    svg.text((MARGIN, MARGIN + 10.0), &TextStyle::heading(20.0), title);
    let provenance = motions.first().map_or("", |motion| &motion.provenance);
    svg.text((MARGIN, MARGIN + 28.0), &TextStyle::plain(Anchor::Start), provenance);
    for (index, motion) in motions.iter().enumerate() {
        let x = MARGIN + (index % legend_columns) as f64 * LEGEND_ENTRY_WIDTH;
        let y = HEADER_HEIGHT + 12.0 + (index / legend_columns) as f64 * LEGEND_ROW_HEIGHT;
        svg.line(&[(x, y - 4.0), (x + 18.0, y - 4.0)], color(index), 2.4);
        let text = format!("{}, seed {}", motion.action, motion.seed);
        svg.text((x + 25.0, y), &TextStyle::plain(Anchor::Start), &text);
    }
    for (index, panel) in panels.iter().enumerate() {
        let column = (index % column_count) as f64;
        let row = (index / column_count) as f64;
        let corner = (MARGIN + column * PANEL_WIDTH, top + row * PANEL_HEIGHT);
        draw_panel(&mut svg, corner, panel, motions);
    }
    svg.finish()
}

fn color(motion: usize) -> &'static str {
    PALETTE[motion % PALETTE.len()]
}

/// Straight map from values to pixels.
struct Axes {
    left: f64,
    right: f64,
    top: f64,
    bottom: f64,
    seconds_max: f64,
    value_min: f64,
    value_max: f64,
}

impl Axes {
    fn point(&self, seconds: f64, value: f64) -> Point {
        let x = self.left + (self.right - self.left) * seconds / self.seconds_max;
        let part = (value - self.value_min) / (self.value_max - self.value_min);
        (x, self.bottom - (self.bottom - self.top) * part)
    }
}

fn draw_panel(svg: &mut Svg, (x, y): Point, panel: &Panel, motions: &[Motion]) {
    let (value_min, value_max) = padded_range(&panel.curves);
    let seconds = motions.iter().map(|m| (m.frame_count() - 1).max(1) as f64 / m.rate_hz);
    let (inset_left, inset_top, inset_bottom) = PANEL_INSET;
    let axes = Axes {
        left: x + inset_left,
        right: x + PANEL_WIDTH - 16.0,
        top: y + inset_top,
        bottom: y + PANEL_HEIGHT - inset_bottom,
        seconds_max: seconds.fold(0.0, f64::max),
        value_min,
        value_max,
    };
    svg.text((axes.left, axes.top - 8.0), &TextStyle::heading(12.0), &panel.name);
    draw_grid(svg, &axes);
    for (index, curve) in panel.curves.iter().enumerate() {
        let rate_hz = motions[index].rate_hz;
        let points: Vec<Point> = curve
            .iter()
            .enumerate()
            .map(|(frame, value)| axes.point(frame as f64 / rate_hz, *value))
            .collect();
        svg.line(&points, color(index), 1.5);
    }
}

fn draw_grid(svg: &mut Svg, axes: &Axes) {
    let (values, decimals) = ticks(axes.value_min, axes.value_max, 4);
    let label = TextStyle { size: 9.5, ..TextStyle::plain(Anchor::End) };
    for value in values {
        let (_, y) = axes.point(0.0, value);
        svg.line(&[(axes.left, y), (axes.right, y)], FAINT, 1.0);
        svg.text((axes.left - 6.0, y + 3.3), &label, &format!("{value:.decimals$}"));
    }
    let label = TextStyle { anchor: Anchor::Middle, ..label };
    let (seconds, decimals) = ticks(0.0, axes.seconds_max, 6);
    for second in seconds {
        let (x, _) = axes.point(second, axes.value_min);
        svg.line(&[(x, axes.bottom), (x, axes.bottom + 3.0)], INK, 0.8);
        svg.text((x, axes.bottom + 13.0), &label, &format!("{second:.decimals$} s"));
    }
    svg.line(&[(axes.left, axes.bottom), (axes.right, axes.bottom)], INK, 0.8);
}

/// Range of all curves with a little air; a flat panel gets some so that its line lies in the
/// middle.
fn padded_range(curves: &[Vec<f64>]) -> (f64, f64) {
    let (min, max) = curves
        .iter()
        .flatten()
        .filter(|value| value.is_finite())
        .fold((f64::INFINITY, f64::NEG_INFINITY), |(min, max), value| {
            (min.min(*value), max.max(*value))
        });
    if min > max {
        return (-1.0, 1.0);
    }
    let size = max.abs().max(min.abs());
    let air = if max - min > FLAT_RANGE * size {
        0.06 * (max - min)
    } else if size > 0.0 {
        0.1 * size
    } else {
        1.0
    };
    (min - air, max + air)
}

fn panels(motions: &[Motion]) -> Vec<Panel> {
    let Some(first) = motions.first() else {
        return Vec::new();
    };
    panel_channels(&first.layout)
        .into_iter()
        .map(|(name, read)| Panel {
            name,
            curves: motions
                .iter()
                .map(|motion| motion.frames().map(|p| read.value(p)).collect())
                .collect(),
        })
        .collect()
}

/// How a panel's value is read from a pose.
#[derive(Clone, Copy)]
enum Read {
    /// The channel itself.
    Channel(usize),
    /// Element of the rotation vector, in degrees, of the six channels from `first`.
    RotationDeg { first: usize, axis: usize },
}

impl Read {
    fn value(self, pose: &[f32]) -> f64 {
        match self {
            Self::Channel(channel) => f64::from(pose[channel]),
            Self::RotationDeg { first, axis } => {
                let six = std::array::from_fn(|element| f64::from(pose[first + element]));
                Rotation::from_6d(&six).rotation_vector()[axis].to_degrees()
            }
        }
    }
}

fn panel_channels(layout: &PoseLayout) -> Vec<(String, Read)> {
    let of_group = |(group, range): (&Group, std::ops::Range<usize>)| -> Vec<(String, Read)> {
        let Group { name, kind, unit } = group;
        let unit = unit.suffix();
        let axis_name = |axis: usize| ["x", "y", "z"][axis];
        match kind {
            GroupKind::Scalar => vec![(format!("{name} ({unit})"), Read::Channel(range.start))],
            GroupKind::Translation | GroupKind::Position => range
                .enumerate()
                .map(|(axis, channel)| {
                    (format!("{name} {} ({unit})", axis_name(axis)), Read::Channel(channel))
                })
                .collect(),
            GroupKind::Rotation6d => (0..3)
                .map(|axis| {
                    let read = Read::RotationDeg { first: range.start, axis };
                    (format!("{name} turn about {} (deg)", axis_name(axis)), read)
                })
                .collect(),
        }
    };
    layout.ranges().flat_map(of_group).collect()
}
