//! A plan for people: what fits, how fast, and what keyframes would take.

use std::fmt;

use super::keyframe_bytes::KeyframeRow;
use super::{BoardPlan, BreakEven, POSE_RATES_HZ, Plan, SAFE_SHARE, TICK_RATES_HZ};
use crate::table::{Table, thousands};

impl fmt::Display for Plan {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(
            out,
            "{} ({}): {} bytes, {} multiply-accumulates a pose, {} channels, {} servos\n",
            self.name,
            self.format,
            thousands(self.blob_bytes as u64),
            thousands(self.multiply_accumulates_per_pose),
            self.channels,
            self.servos
        )?;
        writeln!(out, "{}", boards(&self.boards))?;
        writeln!(out, "{}", loads(&self.boards))?;
        writeln!(
            out,
            "Instructions of poses and ticks follow counts under QEMU; cycles per instruction and waiting for flash \
             are assumed.\nSafe: a tick with every pose in {:.0} % of the processor.\n",
            100.0 * SAFE_SHARE
        )?;
        writeln!(out, "{}", self.keyframe_lines())?;
        writeln!(out, "{}", keyframes(&self.keyframes.rows, &self.break_even))?;
        writeln!(
            out,
            "A model gives clips back approximately (`host-trainer reconstruct` measures it), keyframes within the \
             error above.\n"
        )?;
        write!(out, "{}", self.verdict)
    }
}

impl Plan {
    fn keyframe_lines(&self) -> String {
        let report = &self.keyframes;
        format!(
            "Keyframes of {}: {} clips, {:.1} s, {} curves. Frames as they are: {:.0} bytes/s at one byte a number (up \
             to {:.2}° off), {:.0} at two.\nBytes a second: lines at 3 and 4 bytes a key, cubics at 8 and 14; error of \
             velocity is its root mean square.",
            report.source,
            report.clips,
            report.seconds,
            report.curves,
            report.frame_bytes_per_s[0],
            report.byte_frame_error_deg,
            report.frame_bytes_per_s[1]
        )
    }
}

fn boards(boards: &[BoardPlan]) -> Table {
    let mut table = Table::new([
        "board",
        "core",
        "MHz",
        "flash",
        "RAM",
        "instructions a pose",
        "a tick",
        "ms a pose",
        "from RAM",
        "safe poses/s",
    ]);
    for board in boards {
        let share = |bytes: usize, max: usize| {
            let mark = if bytes <= max { "" } else { " TOO LARGE" };
            format!(
                "{} ({:.0} %){mark}",
                thousands(bytes as u64),
                100.0 * bytes as f64 / max as f64
            )
        };
        table.push([
            board.part.into(),
            board.core.into(),
            board.clock_mhz.to_string(),
            share(board.flash_bytes, board.flash_bytes_max),
            share(board.ram_bytes, board.ram_bytes_max),
            thousands(board.instructions_per_pose),
            thousands(board.instructions_per_tick),
            format!("{:.2}", board.pose_ms),
            board.pose_ms_from_ram.map_or("no room".into(), |ms| format!("{ms:.2}")),
            format!("{:.0}", board.safe_poses_per_s),
        ]);
    }
    table
}

/// What decoding below the rate of the servo loop saves.
fn loads(boards: &[BoardPlan]) -> Table {
    let mut table =
        Table::new(["% of the processor", "poses/s", "50 ticks/s", "100 ticks/s", "200 ticks/s"]);
    for board in boards {
        for (poses, loads) in POSE_RATES_HZ.iter().zip(board.load) {
            let cell = |load: f64| match load <= 1.0 {
                true => format!("{:.1}", 100.0 * load),
                false => "too slow".to_owned(),
            };
            let [a, b, c] = loads.map(cell);
            table.push([board.part.into(), poses.to_string(), a, b, c]);
        }
    }
    debug_assert_eq!(TICK_RATES_HZ, [50.0, 100.0, 200.0]);
    table
}

fn keyframes(rows: &[KeyframeRow], break_even: &[BreakEven]) -> Table {
    let mut table = Table::new([
        "largest error",
        "lines",
        "a curve",
        "velocity °/s",
        "cubics",
        "a curve",
        "velocity °/s",
        "T* s",
        "smaller here",
    ]);
    let pair = |[a, b]: [f64; 2]| format!("{a:.0}–{b:.0}");
    for (row, at) in rows.iter().zip(break_even) {
        let fine = |[a, b]: [f64; 2]| format!("{a:.1}–{b:.1}");
        table.push([
            format!("{}°", row.tolerance_deg),
            pair(row.linear.bytes_per_s),
            fine(row.linear.bytes_per_s_per_curve),
            format!("{:.1}", row.linear.velocity_error_deg_per_s),
            pair(row.cubic.bytes_per_s),
            fine(row.cubic.bytes_per_s_per_curve),
            format!("{:.1}", row.cubic.velocity_error_deg_per_s),
            format!("{:.0}", at.seconds),
            if at.keyframes_win { "keyframes".into() } else { "model".into() },
        ]);
    }
    table
}
