//! Contact sheet of bodies: one row a motion, figures over time seen from the front, its path seen
//! from above.
//!
//! In:  joint positions of motions (from `picture`).
//! Out: SVG; all figures at one scale, every motion on its own floor line.

use crate::body::rotation::{Vector, dot};
use crate::body::skeleton::Skeleton;
use crate::export::Motion;
use crate::layout::Unit;
use crate::picture::svg::{Anchor, FAINT, INK, MUTED, Point, Svg, TextStyle};
use crate::picture::view::{Frames, View};

const MARGIN: f64 = 28.0;
const HEADER_HEIGHT: f64 = 74.0;
const LABEL_WIDTH: f64 = 112.0;
const FIGURE_COUNT: usize = 10;
const CELL_WIDTH: f64 = 104.0;
const BODY_HEIGHT_MAX: f64 = 150.0;
/// Air above the tallest figure, and room below the floor for the times.
const ROW_AIR: (f64, f64) = (16.0, 30.0);
const PATH_WIDTH: f64 = 130.0;
/// Radius of the head as part of the tallest figure's height.
const HEAD_RADIUS: f64 = 0.045;
const LEFT_COLOR: &str = "#2f6fbb";
const RIGHT_COLOR: &str = "#d1603d";

/// Draws all motions; `joints` are their positions. // (motion, frame, joint)
pub fn draw(motions: &[Motion], joints: &[Frames], title: &str) -> String {
    let skeleton = motions.first().and_then(|motion| motion.skeleton.as_ref());
    let view = View::of(skeleton, joints);
    let size = Size::of(&view, joints);
    let row_height = ROW_AIR.0 + size.height_px + ROW_AIR.1;
    let width = 2.0 * MARGIN + LABEL_WIDTH + FIGURE_COUNT as f64 * CELL_WIDTH + PATH_WIDTH;
    let height = HEADER_HEIGHT + motions.len() as f64 * row_height + MARGIN;
    let mut svg = Svg::new(width, height);
    draw_header(&mut svg, motions, title, width);
    for (index, (motion, frames)) in motions.iter().zip(joints).enumerate() {
        let top = HEADER_HEIGHT + index as f64 * row_height;
        let floor_y = top + ROW_AIR.0 + size.height_px;
        draw_label(&mut svg, motion, floor_y - size.height_px / 2.0);
        draw_figures(&mut svg, motion, frames, &view, &size, floor_y);
        let middle = (width - MARGIN - PATH_WIDTH / 2.0, floor_y - size.height_px / 2.0);
        draw_path(&mut svg, motion, frames, &view, &size, middle);
    }
    svg.finish()
}

/// One scale for the whole sheet.
struct Size {
    px_per_unit: f64,
    height_px: f64,
}

impl Size {
    /// So that the tallest rise above a motion's floor fits a row, and the widest pose a cell and a
    /// bit.
    fn of(view: &View, joints: &[Frames]) -> Self {
        let tallest = joints.iter().map(|frames| {
            let heights = frames.iter().flatten().map(|p| dot(*p, view.up));
            heights.fold(f64::NEG_INFINITY, f64::max) - floor(view, frames)
        });
        let widest = joints.iter().flatten().map(|pose| {
            let (root, _) = view.flat(pose[0]);
            pose.iter().map(|p| (view.flat(*p).0 - root).abs()).fold(0.0, f64::max)
        });
        let tallest = tallest.fold(0.0, f64::max).max(1e-9);
        let widest = 2.0 * widest.fold(0.0, f64::max).max(1e-9);
        let px_per_unit = (BODY_HEIGHT_MAX / tallest).min(1.25 * CELL_WIDTH / widest);
        Self { px_per_unit, height_px: px_per_unit * tallest }
    }
}

/// Lowest height of any joint of a motion.
fn floor(view: &View, frames: &Frames) -> f64 {
    frames.iter().flatten().map(|p| dot(*p, view.up)).fold(f64::INFINITY, f64::min)
}

fn draw_header(svg: &mut Svg, motions: &[Motion], title: &str, width: f64) {
    svg.text((MARGIN, MARGIN + 10.0), &TextStyle::heading(20.0), title);
    let provenance = motions.first().map_or("", |motion| &motion.provenance);
    svg.text((MARGIN, MARGIN + 28.0), &TextStyle::plain(Anchor::Start), provenance);
    let y = MARGIN + 10.0;
    let right = width - MARGIN;
    svg.text((right - PATH_WIDTH / 2.0, y), &TextStyle::plain(Anchor::Middle), "path from above");
    let has_sides = motions.iter().any(|motion| {
        let names = motion.skeleton.iter().flat_map(|skeleton| &skeleton.names);
        names.into_iter().any(|name| limb_color(name) != INK)
    });
    if has_sides {
        let sides = [("left of the body", LEFT_COLOR), ("right of the body", RIGHT_COLOR)];
        for (index, (side, color)) in sides.into_iter().enumerate() {
            let x = right - PATH_WIDTH - 250.0 + 122.0 * index as f64;
            svg.line(&[(x, y - 4.0), (x + 16.0, y - 4.0)], color, 3.0);
            svg.text((x + 22.0, y), &TextStyle::plain(Anchor::Start), side);
        }
    }
}

fn draw_label(svg: &mut Svg, motion: &Motion, y: f64) {
    svg.text((MARGIN, y - 4.0), &TextStyle::heading(14.0), &motion.action);
    let text = format!("{:.1} s, seed {}", motion.seconds, motion.seed);
    svg.text((MARGIN, y + 13.0), &TextStyle::plain(Anchor::Start), &text);
}

fn draw_figures(
    svg: &mut Svg,
    motion: &Motion,
    frames: &Frames,
    view: &View,
    size: &Size,
    floor_y: f64,
) {
    let left = MARGIN + LABEL_WIDTH;
    let right = left + FIGURE_COUNT as f64 * CELL_WIDTH;
    svg.line(&[(left, floor_y), (right, floor_y)], FAINT, 1.5);
    let floor = floor(view, frames);
    let count = FIGURE_COUNT.min(frames.len());
    for index in 0..count {
        let frame = index * (frames.len() - 1) / (count - 1).max(1);
        let pose = &frames[frame];
        let x = left + (index as f64 + 0.5) * CELL_WIDTH;
        let (root, _) = view.flat(pose[0]);
        let place = |position: Vector| -> Point {
            let (across, height) = view.flat(position);
            (x + (across - root) * size.px_per_unit, floor_y - (height - floor) * size.px_per_unit)
        };
        draw_figure(svg, motion.skeleton.as_ref(), pose, view, size, &place);
        let seconds = format!("{:.2} s", frame as f64 / motion.rate_hz);
        svg.text((x, floor_y + 16.0), &TextStyle::plain(Anchor::Middle), &seconds);
    }
}

/// Bones from the farthest to the nearest, so that near limbs cover far ones; joints as dots where
/// no tree is known.
fn draw_figure(
    svg: &mut Svg,
    skeleton: Option<&Skeleton>,
    pose: &[Vector],
    view: &View,
    size: &Size,
    place: &dyn Fn(Vector) -> Point,
) {
    let Some(skeleton) = skeleton.filter(|skeleton| skeleton.joint_count() == pose.len()) else {
        for position in pose {
            svg.circle(place(*position), 1.5, INK, INK);
        }
        return;
    };
    let nearness = |joint: usize| dot(pose[joint], view.viewer);
    let mut bones: Vec<(usize, usize)> = skeleton.bones().collect();
    bones.sort_by(|a, b| {
        (nearness(a.0) + nearness(a.1)).total_cmp(&(nearness(b.0) + nearness(b.1)))
    });
    for (parent, child) in bones {
        let color = limb_color(&skeleton.names[child]);
        svg.line(&[place(pose[parent]), place(pose[child])], color, 2.6);
        if skeleton.names[child].to_lowercase().contains("head") {
            svg.circle(place(pose[child]), HEAD_RADIUS * size.height_px, "white", INK);
        }
    }
}

fn limb_color(name: &str) -> &'static str {
    let name = name.to_lowercase();
    if name.contains("left") || name.starts_with("l_") || name.ends_with("_l") {
        LEFT_COLOR
    } else if name.contains("right") || name.starts_with("r_") || name.ends_with("_r") {
        RIGHT_COLOR
    } else {
        INK
    }
}

/// The root's way over the floor, from the hollow to the full dot, with its length; at the figures'
/// scale or smaller.
fn draw_path(
    svg: &mut Svg,
    motion: &Motion,
    frames: &Frames,
    view: &View,
    size: &Size,
    (x, y): Point,
) {
    let across = |pose: &Vec<Vector>| (dot(pose[0], view.right), dot(pose[0], view.viewer));
    let way: Vec<Point> = frames.iter().map(across).collect();
    let range = |values: &dyn Fn(&Point) -> f64| {
        way.iter().map(values).fold((f64::INFINITY, f64::NEG_INFINITY), |(min, max), value| {
            (min.min(value), max.max(value))
        })
    };
    let ((x_min, x_max), (y_min, y_max)) = (range(&|point| point.0), range(&|point| point.1));
    let extent = (x_max - x_min).max(y_max - y_min).max(1e-9);
    let room = (PATH_WIDTH - 30.0).min(size.height_px - 20.0);
    let factor = size.px_per_unit.min(room / extent);
    let points: Vec<Point> = way
        .iter()
        .map(|(across, near)| {
            let center = ((x_min + x_max) / 2.0, (y_min + y_max) / 2.0);
            (x + (across - center.0) * factor, y + (near - center.1) * factor)
        })
        .collect();
    svg.line(&points, MUTED, 1.2);
    if let (Some(start), Some(end)) = (points.first(), points.last()) {
        svg.circle(*start, 2.2, "white", INK);
        svg.circle(*end, 2.2, INK, INK);
    }
    let length: f64 =
        way.windows(2).map(|pair| (pair[1].0 - pair[0].0).hypot(pair[1].1 - pair[0].1)).sum();
    let unit = match motion.layout.groups.first().map(|group| group.unit) {
        None | Some(Unit::One) => "",
        Some(unit) => unit.suffix(),
    };
    let text = format!("{length:.2} {unit} long");
    svg.text((x, y + size.height_px / 2.0 + 16.0), &TextStyle::plain(Anchor::Middle), &text);
}
