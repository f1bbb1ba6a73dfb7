#![no_main]

// The control: a fault behind four bytes, which random inputs meet once in four thousand million.
// A search by coverage that finds nothing here finds nothing elsewhere.
libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    if let [b'T', b'O', b'M', b'B', ..] = bytes {
        panic!("the planted fault");
    }
});
