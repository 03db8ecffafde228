//! An evaluation at a glance: one panel a figure, one line a row, ours between the papers'.
//!
//! In:  [`Evaluation`].
//! Out: SVG.

use super::estimate::Estimate;
use super::papers::PaperRow;
use super::report::{Evaluation, Figures};
use crate::picture::svg::{Anchor, FAINT, INK, MUTED, PALETTE, Svg, TextStyle, ticks};

const MARGIN: f64 = 28.0;
const HEADER_HEIGHT: f64 = 84.0;
const NAME_WIDTH: f64 = 190.0;
const PANEL_WIDTH: f64 = 170.0;
const PANEL_GAP: f64 = 26.0;
const ROW_HEIGHT: f64 = 24.0;
const AXIS_HEIGHT: f64 = 30.0;
const NAME_LEN_MAX: usize = 30;

/// A figure of ours and of the papers.
struct Panel {
    name: &'static str,
    ours: fn(&Figures) -> Option<Estimate>,
    papers: fn(&PaperRow) -> Option<f64>,
}

const PANELS: [Panel; 6] = [
    Panel { name: "FID", ours: |f| Some(f.fid), papers: |p| p.fid },
    Panel { name: "held-out FID", ours: |f| f.fid_held_out, papers: |_| None },
    Panel { name: "accuracy", ours: |f| Some(f.accuracy), papers: |p| p.accuracy },
    Panel { name: "diversity", ours: |f| Some(f.diversity), papers: |p| p.diversity },
    Panel { name: "multimodality", ours: |f| Some(f.multimodality), papers: |p| p.multimodality },
    Panel { name: "MMS", ours: |f| Some(f.mms), papers: |p| p.mms },
];

/// One line of the picture.
struct Line {
    name: String,
    color: &'static str,
    /// // (panel)
    figures: Vec<Option<Estimate>>,
}

/// Draws the rows, worst FID on top.
pub fn draw(evaluation: &Evaluation) -> String {
    let lines = lines(evaluation);
    let panels: Vec<usize> = (0..PANELS.len())
        .filter(|&panel| lines.iter().any(|line| line.figures[panel].is_some()))
        .collect();
    let width = 2.0 * MARGIN + NAME_WIDTH + panels.len() as f64 * (PANEL_WIDTH + PANEL_GAP);
    let bottom = HEADER_HEIGHT + lines.len() as f64 * ROW_HEIGHT;
    let mut svg = Svg::new(width, bottom + AXIS_HEIGHT + MARGIN);
    svg.text(
        (MARGIN, MARGIN + 10.0),
        &TextStyle::heading(18.0),
        "Generated motions beside real ones",
    );
    let hash: String = evaluation.source.config_hash.chars().take(12).collect();
    let subtitle = format!(
        "{} repetitions, seed {}; {} training and {} held-out clips; configuration {hash}, seed {}; bars: 95 %",
        evaluation.protocol.repetitions,
        evaluation.protocol.seed,
        evaluation.data.training_clip_count,
        evaluation.data.held_out_clip_count,
        evaluation.source.seed,
    );
    svg.text((MARGIN, MARGIN + 28.0), &TextStyle::plain(Anchor::Start), &subtitle);
    for (index, line) in lines.iter().enumerate() {
        let style = TextStyle { color: line.color, ..TextStyle::plain(Anchor::Start) };
        svg.text((MARGIN, row_y(index) + 4.0), &style, &line.name);
    }
    for (column, &panel) in panels.iter().enumerate() {
        let left = MARGIN + NAME_WIDTH + column as f64 * (PANEL_WIDTH + PANEL_GAP);
        draw_panel(&mut svg, left, bottom, panel, &lines);
    }
    svg.finish()
}

fn row_y(index: usize) -> f64 {
    HEADER_HEIGHT + (index as f64 + 0.5) * ROW_HEIGHT
}

fn lines(evaluation: &Evaluation) -> Vec<Line> {
    let ours = |name: String, color, figures: &Figures| Line {
        name,
        color,
        figures: PANELS.iter().map(|panel| (panel.ours)(figures)).collect(),
    };
    let exact = |mean| Estimate { mean, ci95: 0.0 };
    let paper = |row: &PaperRow| Line {
        name: row.name.to_owned(),
        color: MUTED,
        figures: PANELS.iter().map(|panel| (panel.papers)(row).map(exact)).collect(),
    };
    let mut lines = vec![
        ours(short(&evaluation.row_name()), PALETTE[1], &evaluation.generated),
        ours("real, cropped again".to_owned(), PALETTE[0], &evaluation.real),
    ];
    lines.extend(evaluation.papers.iter().map(paper));
    let fid = |line: &Line| line.figures[0].map_or(f64::INFINITY, |fid| fid.mean);
    lines.sort_by(|one, other| fid(other).total_cmp(&fid(one)));
    lines
}

/// The end of a long name: of a path the part that tells it from others.
fn short(name: &str) -> String {
    let len = name.chars().count();
    if len <= NAME_LEN_MAX {
        return name.to_owned();
    }
    let end: String = name.chars().skip(len + 1 - NAME_LEN_MAX).collect();
    format!("…{end}")
}

fn draw_panel(svg: &mut Svg, left: f64, bottom: f64, panel: usize, lines: &[Line]) {
    let figures = || lines.iter().filter_map(|line| line.figures[panel]);
    let lowest = figures().map(|figure| figure.mean - figure.ci95).fold(f64::INFINITY, f64::min);
    let highest = figures().map(|f| f.mean + f.ci95).fold(f64::NEG_INFINITY, f64::max);
    let room = (0.08 * (highest - lowest)).max(1e-3 * highest.abs().max(1e-3));
    let (min, max) = (lowest - room, highest + room);
    let x = |value: f64| left + PANEL_WIDTH * (value - min) / (max - min);
    let heading = TextStyle { color: INK, ..TextStyle::heading(12.0) };
    svg.text((left, HEADER_HEIGHT - 10.0), &heading, PANELS[panel].name);
    let (values, decimals) = ticks(min, max, 3);
    for value in values {
        svg.line(&[(x(value), HEADER_HEIGHT), (x(value), bottom)], FAINT, 1.0);
        let style = TextStyle { size: 9.5, ..TextStyle::plain(Anchor::Middle) };
        svg.text((x(value), bottom + 14.0), &style, &format!("{value:.decimals$}"));
    }
    for (index, line) in lines.iter().enumerate() {
        let Some(Estimate { mean, ci95 }) = line.figures[panel] else { continue };
        let y = row_y(index);
        svg.line(&[(x(mean - ci95), y), (x(mean + ci95), y)], line.color, 2.0);
        svg.circle((x(mean), y), 4.0, line.color, "white");
    }
}
