//! A frame of 6.2 MB through five filters, each changing a byte in place.

use trocar::model::Execution;

use crate::baseline;
use crate::lab::{Lab, as_number, stream_of};
use crate::table::{Goal, Table};

/// A frame of 1080p in RGB, B.
const BYTES: usize = 1920 * 1080 * 3;
const FILTERS: usize = 5;
const FRAMES: f64 = 400.0;

pub(crate) fn measure(table: &mut Table) {
    let lab = Lab::new();
    lab.create("camera", "camera", Execution::default());
    let mut from = "camera/frame".to_owned();
    for i in 0..FILTERS {
        lab.create(&format!("pass{i}"), "pass", stream_of("camera"));
        lab.connect(&format!("pass{i}/frame"), &from);
        from = format!("pass{i}/frame_out");
    }
    lab.start();
    let last = format!("pass{}", FILTERS - 1);
    lab.wait(&last, "frames", FRAMES);
    table.title("A frame of 6.2 MB through five filters of one stream, one byte changed in place in each");
    let way = as_number(&lab.invoke(&format!("{last}/time/median"), serde_json::Value::Null));
    table.row(
        "from the camera to the end of the chain",
        way,
        Goal::None,
        "one copy of it",
        baseline::copy(BYTES),
    );
    let sum = |field: &str| (0..FILTERS).map(|i| lab.number(&format!("pass{i}"), field)).sum::<f64>();
    let (moved, shared, frames) = (sum("moved"), sum("shared"), sum("frames"));
    let beside = format!("{frames} looks at the bytes' address");
    let copied = moved * BYTES as f64;
    table.count("bytes copied", &format!("{copied} B"), "0 B", copied == 0.0, &beside);
    let what = "times a filter could not change the frame in place";
    table.count(what, &format!("{shared}"), "0", shared == 0.0, &beside);
}
