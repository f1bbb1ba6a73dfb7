//! `tombolo-simulate`: options, then one simulation, its figures as JSON.

use simulation::config::Args;
use simulation::costs::Costs;
use std::io::Write;
use std::process::ExitCode;
use std::time::Instant;

const NAME: &str = "tombolo-simulate";

fn main() -> ExitCode {
    let args: Args = match cli::parse() {
        Ok(args) => args,
        Err(code) => return code,
    };
    if args.measure_costs {
        return print(&serde_json::json!(Costs::measure(args.world_seed)));
    }
    let plan = match args.plan() {
        Ok(plan) => plan,
        Err(message) => return cli::fail(NAME, message, cli::USAGE),
    };
    let started = Instant::now();
    let report = simulation::run(&plan);
    let (took, events) = (started.elapsed().as_secs_f64(), report.events);
    eprintln!("{NAME}: {} clients, {events} events in {took:.1} s", report.clients);
    let summary = serde_json::json!(report.summary());
    if let Some(file) = &args.json
        && let Err(error) = std::fs::write(file, format!("{summary:#}\n"))
    {
        return cli::fail(NAME, format!("--json: cannot write {}: {error}", file.display()), cli::FAILED);
    }
    if report.wrong > 0 || report.chunks == 0 {
        return cli::fail(NAME, "no chunks, or frames that a client rejected", cli::FAILED);
    }
    print(&summary)
}

/// Prints JSON. A closed output is no error.
fn print(value: &serde_json::Value) -> ExitCode {
    let _ = writeln!(std::io::stdout(), "{value:#}");
    ExitCode::SUCCESS
}
