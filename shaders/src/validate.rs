//! The one gate that every shader passes: naga, restricted to what WebGPU promises everywhere.

use naga::valid::{Capabilities, ModuleInfo, ValidationFlags, Validator};

/// Parses and validates WGSL without any native-only capability; the error shows the offending
/// lines.
pub fn validate(name: &str, wgsl: &str) -> Result<(naga::Module, ModuleInfo), String> {
    let module =
        naga::front::wgsl::parse_str(wgsl).map_err(|error| error.emit_to_string_with_path(wgsl, name))?;
    let info = Validator::new(ValidationFlags::all(), Capabilities::empty())
        .validate(&module)
        .map_err(|error| error.emit_to_string_with_path(wgsl, name))?;
    Ok((module, info))
}
