//! Several managers for one system, over a real etcd.
//!
//! Promise: one of them leads; when it is gone another does, which knows everything that was answered, and
//! components run on. A manager that does not lead changes nothing, and Stop works all the same.

mod leading;
mod quorum;
mod timed;

use rustix::process::{Pid, Signal, kill_process};
use serde_json::{Value, json};
use trocar_tests::{EtcdCluster, Grpcurl, HostProcess, Trocar, World, eventually};

/// A cluster, managers over it, and a host.
struct Lab {
    gcms: Vec<HostProcess>,
    etcd: EtcdCluster,
    world: World,
}

impl Lab {
    fn new(members: usize, managers: usize) -> Lab {
        let world = World::with_plugins(&["example"]);
        let mut lab = Lab { gcms: Vec::new(), etcd: EtcdCluster::start(members), world };
        for _ in 0..managers {
            lab.add_manager();
        }
        lab
    }

    fn add_manager(&mut self) {
        let manager = self.manager(self.gcms.len(), "127.0.0.1:0");
        self.gcms.push(manager);
    }

    /// Starts a manager again that was killed.
    fn restart_manager(&mut self, at: usize) {
        let address = self.gcms[at].address().to_owned();
        self.gcms[at].kill();
        self.gcms[at] = self.manager(at, &address);
    }

    fn manager(&self, at: usize, listen: &str) -> HostProcess {
        self.manager_with(at, listen, &[])
    }

    fn manager_with(&self, at: usize, listen: &str, more: &[&str]) -> HostProcess {
        let name = format!("gcm{at}");
        let state = self.world.state().join(&name);
        let store = self.etcd.place("lab7");
        let args = ["gcm", "--listen", listen, "--store", &store, "--state"].map(Into::into);
        HostProcess::spawn(
            &self.world,
            &name,
            &[&args[..], &[state.into()], &more.iter().map(Into::into).collect::<Vec<_>>()].concat(),
        )
    }

    /// Addresses of all managers, with commas between them.
    fn addresses(&self) -> String {
        self.gcms.iter().map(HostProcess::address).collect::<Vec<_>>().join(",")
    }

    fn trocar(&self) -> Trocar {
        Trocar::at(&self.world, &self.addresses())
    }

    /// Returns the one manager that answers, but for those that do not count.
    fn leader_but(&self, not: &[usize]) -> usize {
        eventually("one manager leads", || {
            let answers = |at: &usize| leads(&self.gcms[*at].grpcurl()).is_ok();
            let leaders: Vec<usize> =
                (0..self.gcms.len()).filter(|at| !not.contains(at)).filter(answers).collect();
            match leaders[..] {
                [one] => Ok(one),
                _ => Err(format!("{leaders:?} lead")),
            }
        })
    }

    fn leader(&self) -> usize {
        self.leader_but(&[])
    }

    fn grpc(&self, at: usize) -> Grpcurl {
        self.gcms[at].grpcurl()
    }

    /// A host that follows whoever leads, with a component that runs and holds 30.
    fn host(&self, name: &str) -> HostProcess {
        let host = HostProcess::start_with(&self.world, name, &["--gcm", &self.addresses()]);
        let grpc = self.grpc(self.leader());
        eventually(&format!("{name} is attached"), || is_attached(&grpc, name));
        grpc.await_class(name, "Server");
        let path = format!("{name}/server");
        grpc.create(&path, "Server", json!({}));
        grpc.start(&path);
        grpc.invoke(&format!("{path}/Provided/Write"), json!(30));
        host
    }

    /// The component of a host runs, and was not made anew since it was given its value.
    fn assert_runs_on(&self, at: usize, name: &str) {
        let grpc = self.grpc(at);
        eventually(&format!("{name} is attached"), || is_attached(&grpc, name));
        assert_eq!(grpc.state(&format!("{name}/server")), "ACTIVE");
        assert_eq!(grpc.invoke(&format!("{name}/server/Provided/Read"), Value::Null), json!(30));
    }
}

fn leads(grpc: &Grpcurl) -> Result<Value, trocar_tests::Failure> {
    grpc.call("GcmService/List", json!({ "brief": true }))
}

fn is_attached(grpc: &Grpcurl, name: &str) -> Result<(), String> {
    let list = leads(grpc).map_err(|refused| refused.to_string())?;
    let processes = list["processes"].as_array().cloned().unwrap_or_default();
    let found = processes.iter().find(|process| process["name"] == name);
    match found.and_then(|process| process["state"].as_str()) {
        Some("PROCESS_STATE_ATTACHED") => Ok(()),
        other => Err(format!("{name} is {other:?}")),
    }
}

/// Every component that is listed.
fn listed(grpc: &Grpcurl) -> Vec<String> {
    let list = grpc.ok("GcmService/List", json!({ "brief": true }));
    let components = list["components"].as_array().cloned().unwrap_or_default();
    components.iter().filter_map(|component| component["path"].as_str().map(str::to_owned)).collect()
}

fn send(pid: u32, signal: Signal) {
    kill_process(Pid::from_raw(pid.try_into().unwrap()).unwrap(), signal).unwrap();
}

/// Value of a name in the details of a refusal.
fn told(refused: &trocar_tests::Failure, name: &str) -> String {
    let values = refused.details.iter().filter_map(|detail| detail["metadata"][name].as_str());
    values.map(str::to_owned).next().unwrap_or_default()
}
