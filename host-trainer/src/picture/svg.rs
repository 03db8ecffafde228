//! The few marks that our pictures are made of, as SVG text.
//!
//! Why not plotters: its SVG backend rounds every point to a whole pixel, which bends the thin
//! limbs of small figures, and it has no round line ends.

use std::fmt::Write;

/// Text and joints.
pub const INK: &str = "#1f2933";
/// Less important text.
pub const MUTED: &str = "#6b7785";
/// Grid and floor lines.
pub const FAINT: &str = "#dde2e8";
/// One colour a variation, told apart by colour-blind people too (Okabe and Ito, 2008, less its
/// yellow and black).
pub const PALETTE: [&str; 6] = ["#0072b2", "#d55e00", "#009e73", "#cc79a7", "#56b4e9", "#e69f00"];

/// A point in pixels, y down.
pub type Point = (f64, f64);

/// Which part of a text stands at its point.
#[derive(Clone, Copy, Debug)]
pub enum Anchor {
    /// The left end.
    Start,
    /// The middle.
    Middle,
    /// The right end.
    End,
}

/// How a text looks.
#[derive(Clone, Copy, Debug)]
pub struct TextStyle {
    /// Which part stands at the point.
    pub anchor: Anchor,
    /// Pixels.
    pub size: f64,
    /// CSS colour.
    pub color: &'static str,
    /// CSS weight: 400 is normal, 600 half bold.
    pub weight: u32,
}

impl TextStyle {
    /// Running text.
    pub const fn plain(anchor: Anchor) -> Self {
        Self { anchor, size: 11.0, color: MUTED, weight: 400 }
    }

    /// A heading.
    pub const fn heading(size: f64) -> Self {
        Self { anchor: Anchor::Start, size, color: INK, weight: 600 }
    }
}

/// A picture that grows mark by mark.
#[derive(Clone, Debug)]
pub struct Svg {
    width: f64,
    height: f64,
    marks: String,
}

impl Svg {
    /// An empty white picture, sizes in pixels.
    pub fn new(width: f64, height: f64) -> Self {
        Self { width, height, marks: String::new() }
    }

    /// A line through all points, with round joins and ends.
    pub fn line(&mut self, points: &[Point], color: &str, width: f64) {
        let list: Vec<String> = points.iter().map(|(x, y)| format!("{x:.2},{y:.2}")).collect();
        self.mark(&format!(
            r#"<polyline points="{}" stroke="{color}" stroke-width="{width}"/>"#,
            list.join(" ")
        ));
    }

    /// A filled circle with a rim of `rim_color`.
    pub fn circle(&mut self, (x, y): Point, radius: f64, color: &str, rim_color: &str) {
        self.mark(&format!(
            r#"<circle cx="{x:.2}" cy="{y:.2}" r="{radius:.2}" fill="{color}" stroke="{rim_color}"
 stroke-width="1.6"/>"#
        ));
    }

    /// A text whose base line is at the point.
    pub fn text(&mut self, (x, y): Point, style: &TextStyle, text: &str) {
        let anchor = match style.anchor {
            Anchor::Start => "start",
            Anchor::Middle => "middle",
            Anchor::End => "end",
        };
        let TextStyle { size, color, weight, .. } = style;
        self.mark(&format!(
            r#"<text x="{x:.1}" y="{y:.1}" text-anchor="{anchor}" font-size="{size}"
 font-weight="{weight}" fill="{color}" stroke="none">{}</text>"#,
            escape(text)
        ));
    }

    fn mark(&mut self, mark: &str) {
        self.marks.push_str(mark);
        self.marks.push('\n');
    }

    /// The whole file.
    pub fn finish(self) -> String {
        let Self { width, height, marks } = self;
        let mut file = String::new();
        // Writing to a String cannot fail.
        let _ = write!(
            file,
            r#"<svg xmlns="http://www.w3.org/2000/svg" width="{width:.0}" height="{height:.0}"
 viewBox="0 0 {width:.0} {height:.0}">
<rect width="100%" height="100%" fill="white"/>
<g font-family="Inter, 'Helvetica Neue', Arial, 'DejaVu Sans', sans-serif" fill="none"
 stroke-linecap="round" stroke-linejoin="round">
{marks}</g>
</svg>
"#
        );
        file
    }
}

fn escape(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

/// Round numbers inside `min..=max`, about `count` of them, and their decimals: steps of 1, 2 or 5
/// times a power of ten.
pub fn ticks(min: f64, max: f64, count: usize) -> (Vec<f64>, usize) {
    let rough = (max - min) / count.max(1) as f64;
    if !(rough.is_finite() && rough > 0.0) {
        return (vec![min], 1);
    }
    let power = 10_f64.powf(rough.log10().floor());
    let step = [1.0, 2.0, 5.0, 10.0].iter().map(|factor| factor * power).find(|s| *s >= rough);
    let step = step.unwrap_or(power);
    let decimals = (-step.log10().floor()).max(0.0) as usize;
    let first = (min / step).ceil() as i64;
    let last = (max / step).floor() as i64;
    ((first..=last).map(|index| index as f64 * step).collect(), decimals)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ticks_of_an_empty_or_infinite_range_are_one() {
        assert_eq!(ticks(3.0, 3.0, 4).0, [3.0]);
        assert_eq!(ticks(0.0, f64::INFINITY, 4).0, [0.0]);
    }

    #[test]
    fn ticks_are_round_and_inside() {
        assert_eq!(ticks(-3.1, 7.9, 4), (vec![0.0, 5.0], 0));
        assert_eq!(ticks(0.0, 1.0, 5).0.len(), 6);
        assert_eq!(ticks(0.013, 0.061, 4).1, 2);
    }

    #[test]
    fn names_with_markup_stay_text() {
        let mut svg = Svg::new(10.0, 10.0);
        svg.text((0.0, 0.0), &TextStyle::heading(10.0), "a<b>&\"c\"");
        assert!(svg.finish().contains("a&lt;b&gt;&amp;&quot;c&quot;"));
    }
}
