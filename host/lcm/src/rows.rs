//! Rows of a state table for readers outside: the newest, that of a tick, one some rows back, or the values
//! at a time.
//!
//! Invariant: never waits and never enters the instance; a time between two rows is answered by
//! [`trocar_model::interpolate`], a time outside the kept rows is refused and never guessed.

use trocar_model::{ComponentId, Refusal, Type, ValueError, interpolate};
use trocar_rt::state::{Miss, RowInfo, StateReader};

use trocar_lcm_api::When;

/// A row, or the values between two rows, with stamp and tick.
pub(super) struct Row {
    pub(super) bytes: Vec<u8>,
    /// Stamp of the row; between two rows the time that was asked for.
    pub(super) stamp_ns: u64,
    /// Tick of the row; between two rows that of the earlier one.
    pub(super) tick: u64,
}

/// Reads a row; `None` for the newest while no row was published.
///
/// # Errors
/// ArgumentInvalid if that row does not exist, does not exist any more, or not yet; the refusal of `misfit`
/// for rows of the component without values in between.
pub(super) fn read(
    rows: &StateReader,
    ty: &Type,
    id: &ComponentId,
    when: When,
    misfit: impl Fn(&ValueError) -> Refusal,
) -> Result<Option<Row>, Refusal> {
    let mut bytes = vec![0; ty.size()];
    let whole = |info: RowInfo, bytes| Row { bytes, stamp_ns: info.stamp_ns, tick: info.tick };
    let info = match when {
        When::Newest => return Ok(rows.latest(&mut bytes).map(|info| whole(info, bytes))),
        When::Tick(tick) => rows.at_tick(tick, &mut bytes),
        When::Delayed(k) => rows.delayed(k, &mut bytes),
        When::Nearest(stamp_ns) => rows.at_time(stamp_ns, &mut bytes),
        When::Time(stamp_ns) => {
            let mut after = bytes.clone();
            return match rows.around(stamp_ns, &mut bytes, &mut after) {
                Ok(around) => {
                    let between = interpolate(ty, &bytes, &after, around.fraction);
                    let bytes = between.map_err(|e| misfit(&e))?;
                    Ok(Some(Row { bytes, stamp_ns, tick: around.before.tick }))
                }
                Err(miss) => Err(refusal(rows, id, when, miss)),
            };
        }
    };
    info.map(|info| Some(whole(info, bytes))).map_err(|miss| refusal(rows, id, when, miss))
}

fn refusal(rows: &StateReader, id: &ComponentId, when: When, miss: Miss) -> Refusal {
    let (field, asked) = match when {
        When::Newest => ("path", "the newest row".to_owned()),
        When::Tick(tick) => ("tick", format!("tick {tick}")),
        When::Delayed(k) => ("delayed", format!("the row {k} before the newest")),
        When::Nearest(ns) => ("nearest_ns", format!("{ns} ns")),
        When::Time(ns) => ("at_ns", format!("{ns} ns")),
    };
    let why = match miss {
        Miss::Empty => "no row was published yet",
        Miss::Lapped => "it has been overwritten",
        Miss::NotYet => "it is not there yet",
        Miss::Missing => "there is no such row",
    };
    let kept = rows.published().min(rows.rows());
    let mut scratch = vec![0; rows.row_bytes()];
    let oldest = rows.delayed(kept.saturating_sub(1), &mut scratch).ok();
    let there = match (oldest, rows.latest(&mut scratch)) {
        (Some(old), Some(new)) => format!(
            "; kept are {kept} rows: ticks {} to {}, {} to {} ns",
            old.tick, new.tick, old.stamp_ns, new.stamp_ns
        ),
        _ => String::new(),
    };
    Refusal::ArgumentInvalid {
        what: format!("Read {id}"),
        why: format!("{asked}: {why}{there}"),
        field: field.to_owned(),
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use trocar_model::Prim;
    use trocar_rt::state::state_table;

    use super::*;

    const NUMBER: Type = Type::Prim(Prim::F64);

    /// Rows 1.0, 2.0 … n at 1000, 2000 … ns with ticks 10, 20 …, in a ring of 4.
    fn table(n: u64) -> StateReader {
        let (mut writer, reader) = state_table(8, 4);
        for i in 1..=n {
            writer.publish(i * 1000, i * 10, |row| row.copy_from_slice(&(i as f64).to_le_bytes()));
        }
        reader
    }

    fn misfit(e: &ValueError) -> Refusal {
        let id = ComponentId::parse("host/robot").unwrap();
        Refusal::ComponentRefused { id, entry: "show its state", text: e.to_string() }
    }

    fn ask(rows: &StateReader, when: When) -> Result<(f64, u64, u64), Refusal> {
        let id = ComponentId::parse("host/robot").unwrap();
        let row = read(rows, &NUMBER, &id, when, misfit)?.unwrap();
        Ok((f64::from_le_bytes(row.bytes.try_into().unwrap()), row.stamp_ns, row.tick))
    }

    #[test]
    fn each_way_of_asking_finds_its_row() {
        let rows = table(3);
        assert_eq!(ask(&rows, When::Newest).unwrap(), (3.0, 3000, 30));
        assert_eq!(ask(&rows, When::Tick(20)).unwrap(), (2.0, 2000, 20));
        assert_eq!(ask(&rows, When::Delayed(2)).unwrap(), (1.0, 1000, 10));
        assert_eq!(ask(&rows, When::Nearest(2400)).unwrap(), (2.0, 2000, 20));
        assert_eq!(ask(&rows, When::Time(2250)).unwrap(), (2.25, 2250, 20));
        assert_eq!(ask(&rows, When::Time(2000)).unwrap(), (2.0, 2000, 20), "a row of that very time is it");
        assert_eq!(ask(&rows, When::Time(3000)).unwrap(), (3.0, 3000, 30), "the newest too");
    }

    #[test]
    fn what_is_not_there_is_refused_with_what_is() {
        let rows = table(6);
        let cases = [
            (When::Tick(10), "tick", "tick 10: it has been overwritten"),
            (When::Tick(70), "tick", "tick 70: it is not there yet"),
            (When::Tick(45), "tick", "tick 45: there is no such row"),
            (When::Delayed(9), "delayed", "the row 9 before the newest: it is not there yet"),
            (When::Time(9000), "at_ns", "9000 ns: it is not there yet"),
            (When::Time(500), "at_ns", "500 ns: it has been overwritten"),
        ];
        for (when, want_field, want) in cases {
            let Refusal::ArgumentInvalid { field, why, .. } = ask(&rows, when).unwrap_err() else {
                panic!("{when:?}")
            };
            assert_eq!(field, want_field);
            assert!(
                why.starts_with(want) && why.contains("kept are 4 rows: ticks 30 to 60, 3000 to 6000 ns"),
                "{why}"
            );
        }
        let none = table(0);
        let id = ComponentId::parse("host/robot").unwrap();
        assert!(read(&none, &NUMBER, &id, When::Newest, misfit).unwrap().is_none());
        assert!(ask(&none, When::Delayed(0)).unwrap_err().to_string().contains("no row was published yet"));
    }
}
