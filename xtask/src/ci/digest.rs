//! The backends of `tombolo-lab digest`, each as a part of its own.

use super::host::Tool;
use super::outcome::Outcome;
use anyhow::{Context, Result};
use serde_json::Value;
use terrain::Kernel;

/// Kernels of any CPU that this program can run on. That of WebAssembly runs in the step `wasm`.
const KERNELS: [&str; 4] = ["scalar", "sse4.1", "avx2", "avx512"];

/// One part for each backend of a report, and one for each kind of backend that the report lacks.
///
/// # Errors
/// The report has no backends.
pub fn parts(report: &Value) -> Result<Vec<(String, Outcome)>> {
    let kernels: Vec<_> = Kernel::available().map(|kernel| kernel.to_string()).collect();
    parts_on(report, &kernels)
}

/// As [`parts`], on a machine with these kernels.
fn parts_on(report: &Value, kernels: &[String]) -> Result<Vec<(String, Outcome)>> {
    let backends = report.get("backends").and_then(Value::as_array).filter(|rows| !rows.is_empty());
    let backends = backends.context("the digest reports no backends")?;
    let text =
        |row: &Value, field: &str| row.get(field).and_then(Value::as_str).unwrap_or("unknown").to_owned();
    let mut parts: Vec<_> = backends
        .iter()
        .map(|row| {
            let (name, detail) = (text(row, "name"), text(row, "detail"));
            let outcome = match text(row, "state").as_str() {
                "equal" => Outcome::Passed,
                "skipped" => Outcome::Skipped { lacks: lacks(&name), reason: detail },
                state => Outcome::Failed(format!("{state}: {detail}")),
            };
            (name, outcome)
        })
        .collect();
    let has = |parts: &[(String, Outcome)], sign: &str| parts.iter().any(|(name, _)| name.contains(sign));
    for kernel in KERNELS {
        if has(&parts, &format!("Rust {kernel} kernel")) {
            continue;
        }
        let outcome = if kernels.iter().any(|known| known == kernel) {
            Outcome::Failed("this CPU has it and the digest does not show it".into())
        } else {
            Outcome::NotHere("this CPU does not have it".into())
        };
        parts.push((format!("Rust {kernel} kernel"), outcome));
    }
    for (sign, name, tool) in [
        (" (vulkan)", "naga -> a Vulkan driver", Tool::Vulkan),
        (" (gl)", "naga -> an OpenGL driver", Tool::OpenGl),
        ("SwiftShader (vulkan)", "naga -> SwiftShader", Tool::SwiftShader),
        ("(Chromium)", "Tint -> SwiftShader", Tool::Chromium),
    ] {
        // SwiftShader is a Vulkan driver of its own, and may name itself in another way.
        let own: Vec<_> = parts.iter().filter(|(name, _)| is_kind(name, tool, sign)).collect();
        if own.is_empty() {
            let reason = "the digest shows none".into();
            parts.push((name.into(), Outcome::Skipped { lacks: tool.name(), reason }));
        }
    }
    Ok(parts)
}

fn is_kind(name: &str, tool: Tool, sign: &str) -> bool {
    let is_swiftshader = name.starts_with("naga") && name.contains("SwiftShader");
    match tool {
        Tool::SwiftShader => is_swiftshader,
        Tool::Vulkan => name.contains(sign) && !is_swiftshader,
        _ => name.contains(sign),
    }
}

/// Missing parts of a skipped backend.
fn lacks(name: &str) -> &'static str {
    if name.contains("(Chromium)") {
        Tool::Chromium.name()
    } else if name.contains("SwiftShader") {
        Tool::SwiftShader.name()
    } else if name.contains("(gl)") {
        Tool::OpenGl.name()
    } else {
        Tool::Vulkan.name()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    fn report(rows: &[(&str, &str)]) -> Value {
        let rows: Vec<_> =
            rows.iter().map(|(name, state)| json!({ "name": name, "state": state, "detail": "x" })).collect();
        json!({ "backends": rows })
    }

    const WHOLE: [(&str, &str); 7] = [
        ("Rust scalar kernel (debug)", "equal"),
        ("Rust sse4.1 kernel (debug)", "equal"),
        ("Rust avx2 kernel (debug)", "equal"),
        ("naga -> llvmpipe (vulkan)", "equal"),
        ("naga -> llvmpipe (gl)", "equal"),
        ("naga -> SwiftShader Device (Subzero) (vulkan)", "equal"),
        ("Tint -> SwiftShader (Chromium)", "equal"),
    ];

    fn of(rows: &[(&str, &str)]) -> Vec<(String, Outcome)> {
        let kernels = ["scalar", "sse4.1", "avx2"].map(String::from);
        let is_passed = |outcome: &Outcome| *outcome == Outcome::Passed;
        parts_on(&report(rows), &kernels).unwrap().into_iter().filter(|(_, o)| !is_passed(o)).collect()
    }

    #[test]
    fn a_kernel_that_the_cpu_lacks_is_not_here_and_one_that_was_not_shown_failed() {
        let shown = of(&WHOLE);
        assert!(matches!(shown.as_slice(), [(name, Outcome::NotHere(_))] if name.contains("avx512")));
        let shown = of(&[&WHOLE[..2], &WHOLE[3..]].concat());
        assert!(shown.iter().any(|(name, o)| name.contains("avx2") && matches!(o, Outcome::Failed(_))));
    }

    #[test]
    fn every_backend_that_is_absent_or_skipped_is_a_skip_that_names_what_is_missing() {
        for (row, tool) in [(3, "vulkan"), (4, "opengl"), (5, "swiftshader"), (6, "chromium")] {
            let mut absent = WHOLE.to_vec();
            let (name, _) = absent.remove(row);
            let mut skipped = absent.clone();
            skipped.push((name, "skipped"));
            for rows in [absent, skipped] {
                let found = of(&rows);
                let is_found =
                    found.iter().any(|(_, o)| matches!(o, Outcome::Skipped { lacks, .. } if *lacks == tool));
                assert!(is_found, "{tool}: {found:?}");
            }
        }
    }

    #[test]
    fn other_states_fail_and_a_report_without_backends_is_an_error() {
        let mut rows = WHOLE.to_vec();
        rows[3].1 = "different";
        assert!(of(&rows).iter().any(|(_, o)| matches!(o, Outcome::Failed(_))));
        assert!(parts_on(&Value::Null, &[]).is_err() && parts_on(&report(&[]), &[]).is_err());
    }
}
