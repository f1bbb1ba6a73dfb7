#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    let _ = entry_points::proxy::run(bytes);
});
