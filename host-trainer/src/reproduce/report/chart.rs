//! The pictures of the report: FID of every row, and FID against what it costs.
//!
//! In:  the records of the rows; what the papers print.
//! Out: [`Chart`]s, none where nothing was measured.

use super::sources;
use crate::picture::svg::{Anchor, FAINT, INK, MUTED, PALETTE, Svg, TextStyle, ticks};
use crate::reproduce::Reproduction;
use crate::reproduce::experiments::Experiments;
use crate::reproduce::record::SourceRecord;

/// One picture.
pub struct Chart {
    /// Its file beside the report.
    pub file: &'static str,
    /// What it shows.
    pub title: &'static str,
    /// The file's text.
    pub svg: String,
}

/// A named dot.
struct Dot {
    label: String,
    x: f64,
    y: f64,
    color: &'static str,
}

const WIDTH: f64 = 900.0;
const MARGIN: f64 = 28.0;
const ROW_HEIGHT: f64 = 20.0;
/// Room left of the dots for names.
const LABEL_WIDTH: f64 = 250.0;
const PANEL_HEIGHT: f64 = 460.0;

/// All pictures that the records allow.
pub fn all(experiments: &Experiments, reproduction: &Reproduction) -> Vec<Chart> {
    let fids = fid_rows(experiments, reproduction);
    let fid_chart = (!fids.is_empty()).then(|| Chart {
        file: "fid.svg",
        title: "FID of every row",
        svg: dot_rows("FID of every row; papers in grey", &fids),
    });
    let held_out = scatter_dots(reproduction, |source, twin| {
        let held_out = twin?.evaluation.as_ref()?.fid_held_out?;
        Some((fid(source)?, held_out.mean))
    });
    let bytes = scatter_dots(reproduction, |source, _| {
        Some((source.blob.as_ref()?.bytes as f64 / 1024.0, fid(source)?))
    });
    let macs =
        scatter_dots(reproduction, |source, _| Some((source.macs_per_pose as f64, fid(source)?)));
    let errors = scatter_dots(reproduction, |source, _| {
        Some((source.blob.as_ref()?.bytes as f64 / 1024.0, source.reconstruction.joint_mm?))
    });
    let scatter = |file, title, axes, dots: Vec<Dot>| {
        (dots.len() > 1).then(|| Chart { file, title, svg: scatter(title, axes, &dots) })
    };
    let scatters = [
        scatter(
            "fid-held-out.svg",
            "FID to training clips and to clips never seen",
            ["FID to training clips", "FID to held-out clips, of the twin that did not see them"],
            held_out,
        ),
        scatter("fid-bytes.svg", "FID against flash", ["blob, KiB", "FID"], bytes),
        scatter("fid-macs.svg", "FID against work", ["multiply-accumulates a pose", "FID"], macs),
        scatter(
            "error-bytes.svg",
            "Clips given back against flash",
            ["blob, KiB", "mean distance of joints, mm"],
            errors,
        ),
    ];
    fid_chart.into_iter().chain(scatters.into_iter().flatten()).collect()
}

fn fid(source: &SourceRecord) -> Option<f64> {
    Some(source.evaluation.as_ref()?.fid.mean)
}

/// Papers first, then ours.
fn fid_rows(experiments: &Experiments, reproduction: &Reproduction) -> Vec<Dot> {
    let ours: Vec<Dot> = sources(reproduction)
        .filter_map(|(row, source, _)| {
            let label = format!("{}, {}", row.name, source.source);
            Some(Dot { label, x: fid(source)?, y: 0.0, color: color_of(source) })
        })
        .collect();
    if ours.is_empty() {
        return ours;
    }
    let papers = experiments.papers.iter().filter_map(|paper| {
        Some(Dot { label: paper.name.clone(), x: paper.fid?, y: 0.0, color: MUTED })
    });
    papers.chain(ours).collect()
}

/// A colour a number format.
fn color_of(source: &SourceRecord) -> &'static str {
    match source.source.as_str() {
        "float" => PALETTE[0],
        "w8a16" => PALETTE[2],
        "w8a8" => PALETTE[1],
        "w4a8" => PALETTE[3],
        _ => PALETTE[4],
    }
}

fn scatter_dots(
    reproduction: &Reproduction,
    place: impl Fn(&SourceRecord, Option<&SourceRecord>) -> Option<(f64, f64)>,
) -> Vec<Dot> {
    let dots = sources(reproduction).filter_map(|(row, source, twin)| {
        let (x, y) = place(source, twin).filter(|(x, y)| *x > 0.0 && *y > 0.0)?;
        let label = format!("{} {}", row.name, source.source);
        Some(Dot { label, x, y, color: color_of(source) })
    });
    dots.collect()
}

/// One line a dot, logarithmic from left to right: rows lie decades apart.
fn dot_rows(title: &str, dots: &[Dot]) -> String {
    let height = 2.0 * MARGIN + 60.0 + dots.len() as f64 * ROW_HEIGHT;
    let mut svg = Svg::new(WIDTH, height);
    svg.text((MARGIN, MARGIN + 8.0), &TextStyle::heading(16.0), title);
    let axis = LogAxis::of(dots.iter().map(|dot| dot.x));
    let x_of =
        |value| MARGIN + LABEL_WIDTH + axis.share(value) * (WIDTH - 2.0 * MARGIN - LABEL_WIDTH);
    let top = MARGIN + 30.0;
    let bottom = top + dots.len() as f64 * ROW_HEIGHT;
    for tick in axis.ticks() {
        let x = x_of(tick);
        svg.line(&[(x, top), (x, bottom)], FAINT, 1.0);
        svg.text((x, bottom + 16.0), &TextStyle::plain(Anchor::Middle), &number(tick));
    }
    for (index, dot) in dots.iter().enumerate() {
        let y = top + (index as f64 + 0.5) * ROW_HEIGHT;
        let end = MARGIN + LABEL_WIDTH - 12.0;
        let style = TextStyle { color: INK, ..TextStyle::plain(Anchor::End) };
        svg.text((end, y + 4.0), &style, &dot.label);
        svg.circle((x_of(dot.x), y), 5.0, dot.color, "white");
        let place = (x_of(dot.x) + 9.0, y + 4.0);
        svg.text(place, &TextStyle::plain(Anchor::Start), &number(dot.x));
    }
    svg.finish()
}

/// Named dots on two logarithmic axes.
fn scatter(title: &str, [x_name, y_name]: [&str; 2], dots: &[Dot]) -> String {
    let mut svg = Svg::new(WIDTH, PANEL_HEIGHT + 2.0 * MARGIN + 70.0);
    svg.text((MARGIN, MARGIN + 8.0), &TextStyle::heading(16.0), title);
    svg.text((MARGIN, MARGIN + 28.0), &TextStyle::plain(Anchor::Start), y_name);
    let (x_axis, y_axis) =
        (LogAxis::of(dots.iter().map(|dot| dot.x)), LogAxis::of(dots.iter().map(|dot| dot.y)));
    let (left, right) = (MARGIN + 50.0, WIDTH - MARGIN - 110.0);
    let (top, bottom) = (MARGIN + 40.0, MARGIN + 40.0 + PANEL_HEIGHT);
    let x_of = |value| left + x_axis.share(value) * (right - left);
    let y_of = |value| bottom - y_axis.share(value) * (bottom - top);
    for tick in x_axis.ticks() {
        svg.line(&[(x_of(tick), top), (x_of(tick), bottom)], FAINT, 1.0);
        let place = (x_of(tick), bottom + 16.0);
        svg.text(place, &TextStyle::plain(Anchor::Middle), &number(tick));
    }
    for tick in y_axis.ticks() {
        svg.line(&[(left, y_of(tick)), (right, y_of(tick))], FAINT, 1.0);
        let place = (left - 8.0, y_of(tick) + 4.0);
        svg.text(place, &TextStyle::plain(Anchor::End), &number(tick));
    }
    svg.text((right, bottom + 34.0), &TextStyle::plain(Anchor::End), x_name);
    for dot in dots {
        let (x, y) = (x_of(dot.x), y_of(dot.y));
        svg.circle((x, y), 5.0, dot.color, "white");
        svg.text((x + 8.0, y - 4.0), &TextStyle::plain(Anchor::Start), &dot.label);
    }
    svg.finish()
}

/// From a little below the least value to a little above the greatest.
struct LogAxis {
    min: f64,
    max: f64,
}

impl LogAxis {
    fn of(values: impl Iterator<Item = f64> + Clone) -> Self {
        let min = values.clone().fold(f64::INFINITY, f64::min).max(f64::MIN_POSITIVE);
        let max = values.fold(min, f64::max);
        Self { min: min.ln() - 0.15, max: max.ln() + 0.15 }
    }

    fn share(&self, value: f64) -> f64 {
        (value.max(f64::MIN_POSITIVE).ln() - self.min) / (self.max - self.min)
    }

    /// 1, 2 and 5 of every decade; evenly placed numbers where these are fewer than two.
    fn ticks(&self) -> Vec<f64> {
        let (min, max) = (self.min.exp(), self.max.exp());
        let decades = min.log10().floor() as i32..=max.log10().ceil() as i32;
        let of_decades = decades.flat_map(|power| [1.0, 2.0, 5.0].map(|f| f * 10_f64.powi(power)));
        let found: Vec<f64> = of_decades.filter(|tick| (min..=max).contains(tick)).collect();
        if found.len() < 2 { ticks(min, max, 4).0 } else { found }
    }
}

/// Three digits that matter.
fn number(value: f64) -> String {
    let decimals = (2.0 - value.abs().max(1e-9).log10().floor()).clamp(0.0, 4.0) as usize;
    let text = format!("{value:.decimals$}");
    match text.contains('.') {
        true => text.trim_end_matches('0').trim_end_matches('.').to_owned(),
        false => text,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn dots_of_one_place_are_drawn_inside_the_picture() {
        let dot = || Dot { label: "a<b".into(), x: 0.1, y: 40.0, color: INK };
        let svg = scatter("t", ["x", "y"], &[dot(), dot()]);
        assert!(svg.contains("a&lt;b") && !svg.contains("NaN") && !svg.contains("inf"), "{svg}");
    }

    #[test]
    fn numbers_keep_three_digits() {
        assert_eq!([0.114, 2.0, 256.4, 0.02].map(number), ["0.114", "2", "256", "0.02"]);
        assert_eq!(number(1_140_700.0), "1140700");
    }

    #[test]
    fn axis_has_round_ticks_inside() {
        let axis = LogAxis::of([0.06, 0.4].into_iter());
        assert_eq!(axis.ticks(), [0.1, 0.2]);
        assert!(axis.share(0.06) > 0.0 && axis.share(0.4) < 1.0);
    }
}
