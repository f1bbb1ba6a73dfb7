//! The steps on a machine that only answers: every command succeeds, except what a hidden tool is
//! needed for. It shows whether a run can be green that did not look.

use super::host::{Host, Tool};
use super::outcome::Report;
use super::steps::{self, Step};
use anyhow::{Result, bail};
use serde_json::{Value, json};
use std::path::Path;
use std::process::Command;
use terrain::Kernel;

/// The fault of the machine.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Fault {
    None,
    /// A tool is not installed.
    Hidden(Tool),
    /// Every command and every check fails.
    All,
}

struct Rehearsal(Fault);

impl Rehearsal {
    fn needs(&self, tools: &[Tool]) -> Result<()> {
        match self.0 {
            Fault::None => Ok(()),
            Fault::Hidden(tool) if !tools.contains(&tool) => Ok(()),
            fault => bail!("{fault:?}"),
        }
    }
}

/// The tools that a command cannot do without.
fn tools_of(command: &Command) -> Vec<Tool> {
    let words: Vec<_> = command.get_args().map(|word| word.to_string_lossy().into_owned()).collect();
    let first = words.first().map_or("", String::as_str);
    let has_env = |name: &str| command.get_envs().any(|(key, value)| key == name && value.is_some());
    let folder = command.get_current_dir().map(|path| path.to_string_lossy().into_owned());
    let is_in = |name: &str| folder.as_ref().is_some_and(|folder| folder.ends_with(name));
    let program =
        Path::new(command.get_program()).file_name().map(|name| name.to_string_lossy().into_owned());
    let mut tools = Vec::new();
    let mut add = |is_needed: bool, more: &[Tool]| {
        if is_needed {
            tools.extend_from_slice(more);
        }
    };
    add(program.as_deref() == Some("node"), &[Tool::Node]);
    add(first == "fmt", &[Tool::Rustfmt]);
    add(first == "clippy", &[Tool::Clippy]);
    add(first == "nextest", &[Tool::Nextest]);
    add(first == "deny", &[Tool::Deny]);
    add(has_env("TOMBOLO_REQUIRE_GPU"), &[Tool::Vulkan]);
    add(has_env("TOMBOLO_REQUIRE_DISPLAY"), &[Tool::Xvfb]);
    add(has_env("TOMBOLO_REQUIRE_BROWSER"), &[Tool::Chromium]);
    add(words.iter().any(|word| word == "wasm32-unknown-unknown"), &[Tool::WasmTarget]);
    add(is_in("noise-comparison") && first != "fmt", &[Tool::Clang, Tool::Cmake, Tool::FastSimd]);
    add(is_in("lerc") && first != "fmt", &[Tool::Libclang]);
    add(is_in("land-comparison") && first != "fmt", &[Tool::History]);
    tools
}

impl Host for Rehearsal {
    fn begin(&self, _: &str, _: &str) {}

    fn lacks(&self, tool: Tool) -> Option<String> {
        (self.0 == Fault::Hidden(tool)).then(|| "hidden".into())
    }

    fn run(&self, command: Command) -> Result<()> {
        self.needs(&tools_of(&command))
    }

    fn output(&self, command: Command) -> Result<String> {
        self.needs(&tools_of(&command))?;
        let is_list = command.get_args().any(|word| word == "--list");
        Ok(if is_list { "schedules::x: test\n" } else { "scalar 0123456789abcdef\n" }.into())
    }

    fn report(&self, command: Command, _: &Path) -> Result<Value> {
        self.needs(&tools_of(&command))?;
        let row = |name: String, state: &str| json!({ "name": name, "state": state, "detail": "rehearsed" });
        let kernels = Kernel::available().map(|kernel| row(format!("Rust {kernel} kernel"), "equal"));
        let drivers = [
            ("naga -> x (vulkan)", Tool::Vulkan),
            ("naga -> x (gl)", Tool::OpenGl),
            ("naga -> SwiftShader (vulkan)", Tool::SwiftShader),
            ("Tint -> SwiftShader (Chromium)", Tool::Chromium),
        ];
        let state = |tool| if self.0 == Fault::Hidden(tool) { "skipped" } else { "equal" };
        let drivers = drivers.into_iter().map(|(name, tool)| row(name.into(), state(tool)));
        Ok(json!({ "backends": kernels.chain(drivers).collect::<Vec<_>>() }))
    }

    fn own(&self, _: fn() -> Result<()>) -> Result<()> {
        self.needs(&[])
    }
}

/// Tools without which a run is green all the same, and steps that pass where every command fails.
/// None if the control fails: a run in which nothing is hidden must be green.
pub fn green_without_looking() -> Option<Vec<&'static str>> {
    green_without_looking_of(&steps::ALL)
}

fn green_without_looking_of(steps: &[Step]) -> Option<Vec<&'static str>> {
    let run = |steps: &[Step], fault| super::run_steps(&Rehearsal(fault), steps, Report::default());
    if !run(steps, Fault::None).is_green() {
        return None;
    }
    let tools = Tool::ALL.into_iter().filter(|tool| run(steps, Fault::Hidden(*tool)).is_green());
    let blind = steps.iter().filter(|step| run(&[**step], Fault::All).is_green());
    Some(tools.map(Tool::name).chain(blind.map(|step| step.name)).collect())
}

#[cfg(test)]
mod tests {
    use super::super::outcome::Outcome;
    use super::super::steps::Shown;
    use super::*;

    #[test]
    fn without_any_one_tool_no_run_is_green_and_with_all_it_is() {
        assert_eq!(green_without_looking(), Some(Vec::new()));
    }

    #[test]
    fn a_step_that_does_not_look_is_found() {
        let blind = Step {
            name: "blind",
            about: "",
            again: "",
            action: |_| Ok(Shown { outcome: Outcome::Passed, parts: Vec::new() }),
        };
        let found = green_without_looking_of(&[blind]).unwrap();
        assert_eq!(found.len(), Tool::ALL.len() + 1);
        assert_eq!(found.last(), Some(&"blind"));
        let red = Step { action: |_| bail!("red"), ..blind };
        assert_eq!(green_without_looking_of(&[red]), None);
    }

    #[test]
    fn what_may_be_skipped_by_name_is_green_without_that_tool_alone() {
        let allowed = Report { allowed: vec!["tint".into()], ..Report::default() };
        let run =
            |tool| super::super::run_steps(&Rehearsal(Fault::Hidden(tool)), &steps::ALL, allowed.clone());
        assert!(run(Tool::Tint).is_green());
        assert!(!run(Tool::Chromium).is_green());
    }
}
