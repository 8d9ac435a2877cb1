//! A state row or an output, read once.

use std::time::{Duration, Instant};

use serde_json::json;
use trocar_lcm_api::{Sample, When};
use trocar_model::{ComponentId, PortId, Refusal};
use trocar_rt::os;

use super::super::instance::Instance;
use super::super::rows;
use super::output::{Output, Want};
use super::{Shows, not_shown, shown};

/// Time between two looks at an output until it gives a sample.
const LOOK: Duration = Duration::from_millis(1);

/// The state row of `process/component`, or the next sample of `process/component/output`.
pub(crate) async fn read(
    lcm: &impl Shows,
    path: &str,
    when: When,
    frame: bool,
    deadline: Instant,
) -> Result<Sample, Refusal> {
    if path.split('/').count() == 2 {
        let instance = lcm.component(&ComponentId::parse(path)?)?;
        return state_row(&instance, when);
    }
    let port = PortId::parse(path)?;
    if when != When::Newest {
        return Err(Refusal::ArgumentInvalid {
            what: format!("Read {path}"),
            why: format!("an output keeps no rows, only the state of `{}` does", port.component),
            field: "path".into(),
        });
    }
    let want = if frame { Want::Frame } else { Want::Value };
    let mut output = Output::open(lcm, &port, want)?;
    let began = Instant::now();
    loop {
        let Some(newest) = output.newest().await else {
            return Err(Refusal::Internal { text: format!("{port} was read while its process ended") });
        };
        if let Some((shown, _)) = newest {
            return shown.sample(output.shared());
        }
        if Instant::now() >= deadline {
            let state = output.shared().instance.state();
            return Err(Refusal::NoSample { port, state, after_ns: began.elapsed().as_nanos() as u64 });
        }
        tokio::time::sleep(LOOK).await;
    }
}

fn state_row(instance: &Instance, when: When) -> Result<Sample, Refusal> {
    const ENTRY: &str = "show its state";
    let ports = instance.ports();
    let mut sample = Sample { value: json!({}), ..Sample::default() };
    let misfit = |e: &_| not_shown(instance, ENTRY, e);
    if let Some(ty) = &ports.state
        && let Some(row) = rows::read(&instance.rows, ty, &instance.id, when, misfit)?
    {
        sample.value = shown(instance, ENTRY, ty, &row.bytes)?;
        sample.stamp_ns = row.stamp_ns;
        sample.age_ns = os::now_ns().saturating_sub(row.stamp_ns);
        sample.seq = row.tick;
        sample.encoded = row.bytes;
    }
    Ok(sample)
}
