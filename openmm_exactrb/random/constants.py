"""Constants of Philox4x64; names in capitals are also macros of the kernel texts."""

#: The multipliers of the first and of the third word of the counter.
PHILOX_FIRST, PHILOX_THIRD = 0xD2E7470EE14C6C93, 0xCA5A826395121157
#: The increments of the two words of the key.
PHILOX_KEY, PHILOX_SECOND_KEY = 0x9E3779B97F4A7C15, 0xBB67AE8584CAA73B
#: The number of rounds.
PHILOX_ROUNDS = 10
