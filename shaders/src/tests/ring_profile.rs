//! Integer passes against the ring profile, with a control that must fail.

use crate::SHADERS;
use crate::validate::validate;
use naga::{BinaryOperator, Expression, ScalarKind};

/// Everything in a shader that the ring profile forbids: arithmetic on floats, and `/` or `%` on
/// signed integers.
fn outside_the_ring_profile(name: &str, wgsl: &str) -> Vec<String> {
    let (module, info) = validate(name, wgsl).unwrap_or_else(|complaint| panic!("{complaint}"));
    let functions = module.functions.iter().map(|(handle, function)| (function, &info[handle]));
    let entries = module.entry_points.iter().enumerate();
    let entries = entries.map(|(index, entry)| (&entry.function, info.get_entry_point(index)));
    let mut found = Vec::new();
    for (function, types) in functions.chain(entries) {
        for (handle, expression) in function.expressions.iter() {
            let scalar = types[handle].ty.inner_with(&module.types).scalar_kind();
            let divides = matches!(
                expression,
                Expression::Binary { op: BinaryOperator::Divide | BinaryOperator::Modulo, .. }
            );
            let place = function.name.as_deref().unwrap_or("an entry point");
            if divides && scalar == Some(ScalarKind::Sint) {
                found.push(format!("{place}: signed `/` or `%`"));
            }
            if scalar == Some(ScalarKind::Float) {
                found.push(format!("{place}: a float"));
            }
        }
    }
    found
}

#[test]
fn integer_passes_keep_to_the_ring_profile() {
    for shader in [SHADERS.fill_chunks, SHADERS.probe_heights, SHADERS.cull_blocks, SHADERS.scan_plants] {
        assert_eq!(
            outside_the_ring_profile(shader.name, shader.wgsl),
            Vec::<String>::new(),
            "{}",
            shader.name
        );
    }
    let float = SHADERS.probe_heights_float;
    assert!(outside_the_ring_profile(float.name, float.wgsl).iter().any(|found| found.contains("a float")));
    // The tempting way to write it.
    let tempting = SHADERS.probe_heights.wgsl.replacen("mod_trunc(probe.x, probe.y)", "probe.x % probe.y", 1);
    assert_ne!(tempting, SHADERS.probe_heights.wgsl);
    let found = outside_the_ring_profile("tempting", &tempting);
    assert!(found.len() == 1 && found[0].contains('%'), "{found:?}");
}
