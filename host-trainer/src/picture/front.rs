//! The front of samplers: Fréchet distance against flash, both on logarithmic scales.
//!
//! In:  a mark a sampler, from the command `samplers`.
//! Out: SVG.

use crate::picture::svg::{Anchor, FAINT, INK, MUTED, PALETTE, Point, Svg, TextStyle};

const MARGIN: f64 = 28.0;
const PLOT: (f64, f64) = (560.0, 420.0);
const LIST_WIDTH: f64 = 470.0;
const LIST_ROW_HEIGHT: f64 = 15.0;
const HEADER_HEIGHT: f64 = 60.0;
const AXIS_INSET: f64 = 44.0;

/// One sampler.
#[derive(Clone, Debug, PartialEq)]
pub struct Mark {
    /// What it is.
    pub name: String,
    /// Flash.
    pub kib: f64,
    /// Fréchet distance.
    pub fid: f64,
    /// No other is better in both.
    pub is_on_front: bool,
}

/// From 1 to 9 times a power of ten, so that both ends of the values lie inside.
struct Axis {
    min: f64,
    max: f64,
}

impl Axis {
    fn new(values: impl Iterator<Item = f64> + Clone) -> Self {
        let min = values.clone().fold(f64::INFINITY, f64::min).max(1e-6);
        let max = values.fold(0.0, f64::max).max(2.0 * min);
        Self { min: min / 1.15, max: max * 1.15 }
    }

    fn part(&self, value: f64) -> f64 {
        (value.max(self.min) / self.min).ln() / (self.max / self.min).ln()
    }

    /// 1, 2 and 5 times every power of ten that lies inside.
    fn ticks(&self) -> Vec<f64> {
        let decades = self.min.log10().floor() as i32..=self.max.log10().ceil() as i32;
        let ticks = decades.flat_map(|decade| [1.0, 2.0, 5.0].map(|x| x * 10_f64.powi(decade)));
        ticks.filter(|tick| (self.min..=self.max).contains(tick)).collect()
    }
}

/// Draws all marks, those on the front in colour and joined.
pub fn draw(title: &str, marks: &[Mark]) -> String {
    let mut marks: Vec<&Mark> = marks.iter().collect();
    marks.sort_by(|a, b| a.kib.total_cmp(&b.kib).then(a.fid.total_cmp(&b.fid)));
    let list_height = (marks.len() as f64 + 1.0) * LIST_ROW_HEIGHT;
    let height = HEADER_HEIGHT + list_height.max(PLOT.1) + MARGIN + AXIS_INSET;
    let mut svg = Svg::new(2.0 * MARGIN + AXIS_INSET + PLOT.0 + MARGIN + LIST_WIDTH, height);
    svg.text((MARGIN, MARGIN + 10.0), &TextStyle::heading(20.0), title);
    let caption =
        "Fréchet distance to the training clips against the sampler's flash; lower left is better";
    svg.text((MARGIN, MARGIN + 28.0), &TextStyle::plain(Anchor::Start), caption);
    let kib = Axis::new(marks.iter().map(|mark| mark.kib));
    let fid = Axis::new(marks.iter().map(|mark| mark.fid));
    let (left, bottom) = (MARGIN + AXIS_INSET, HEADER_HEIGHT + PLOT.1);
    let at = |x: f64, y: f64| (left + PLOT.0 * kib.part(x), bottom - PLOT.1 * fid.part(y));
    draw_axes(&mut svg, &kib, &fid, at);
    let front = marks.iter().filter(|mark| mark.is_on_front);
    let front: Vec<Point> = front.map(|mark| at(mark.kib, mark.fid)).collect();
    svg.line(&front, PALETTE[0], 1.4);
    let list_left = left + PLOT.0 + MARGIN;
    for (index, mark) in marks.iter().enumerate() {
        let color = if mark.is_on_front { PALETTE[0] } else { MUTED };
        let (x, y) = at(mark.kib, mark.fid);
        svg.circle((x, y), 3.5, color, "white");
        let number = TextStyle { size: 9.0, color, ..TextStyle::plain(Anchor::Start) };
        svg.text((x + 5.0, y - 4.0), &number, &(index + 1).to_string());
        let row = HEADER_HEIGHT + (index as f64 + 1.0) * LIST_ROW_HEIGHT;
        let style = TextStyle { size: 10.5, color, ..TextStyle::plain(Anchor::Start) };
        let text = format!("{}  {:.4}  {:.1} KiB  {}", index + 1, mark.fid, mark.kib, mark.name);
        svg.text((list_left, row), &style, &text);
    }
    svg.finish()
}

fn draw_axes(svg: &mut Svg, kib: &Axis, fid: &Axis, at: impl Fn(f64, f64) -> Point) {
    let label = TextStyle { size: 9.5, ..TextStyle::plain(Anchor::Middle) };
    for tick in kib.ticks() {
        let (x, bottom) = at(tick, fid.min);
        svg.line(&[(x, bottom), at(tick, fid.max)], FAINT, 1.0);
        svg.text((x, bottom + 14.0), &label, &format!("{tick} KiB"));
    }
    for tick in fid.ticks() {
        let (left, y) = at(kib.min, tick);
        svg.line(&[(left, y), at(kib.max, tick)], FAINT, 1.0);
        let style = TextStyle { anchor: Anchor::End, ..label };
        svg.text((left - 6.0, y + 3.3), &style, &format!("{}", (tick * 1e6).round() / 1e6));
    }
    svg.line(&[at(kib.min, fid.max), at(kib.min, fid.min), at(kib.max, fid.min)], INK, 0.8);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_marks_make_an_empty_front() {
        assert!(draw("none", &[]).contains("</svg>"));
    }

    #[test]
    fn every_mark_is_named_and_all_lie_inside() {
        let mark = |kib, fid| Mark { name: format!("m{kib}"), kib, fid, is_on_front: true };
        let picture = draw("front", &[mark(500.0, 0.09), mark(19.0, 0.3)]);
        assert!(picture.contains("m500") && picture.contains("m19"));
        assert!(!picture.contains("NaN") && !picture.contains("\"-"));
    }
}
