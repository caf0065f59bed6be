"use strict";
// What uPlot does not decide as curves need it: how far an axis reaches beyond what was measured, and where its ticks stand.
(() => {
  const AIR = 0.06; // of an axis, free at each end, so that the frame cuts no mark
  const FACTOR = 1.15; // that a logarithmic axis reaches beyond its ends at least: one value alone has no span to take a share of
  const STEPS = [1, 2, 5];
  const FEW = 3, MANY = 9; // ticks of a logarithmic axis: with fewer they stand at even steps, with more at powers of ten
  const INTERVALS = 7; // between the ticks of an even axis, at most

  bench.reach = (low, high, log) => {
    if (log) {
      const factor = Math.max((high / low) ** AIR, FACTOR);
      return [low / factor, high * factor];
    }
    const air = AIR * (high - low) || 0.1 * Math.abs(low) || 0.5;
    return [low - air, high + air];
  };

  const even = (low, high) => {
    const rough = (high - low) / INTERVALS, power = 10 ** Math.floor(Math.log10(rough));
    const step = power * [...STEPS, 10].find((factor) => factor * power >= rough * (1 - 1e-9));
    const first = Math.ceil(low / step - 1e-9), count = Math.floor(high / step + 1e-9) - first + 1;
    return Array.from({ length: count }, (_, at) => (first + at) * step);
  };

  // Ticks at 1, 2 and 5 times powers of ten; on a logarithmic axis that spans too little for these, at steps of 1, 2 or 5.
  bench.ticks = (low, high, log) => {
    if (!log) return even(low, high);
    const first = Math.floor(Math.log10(low)), powers = Array.from({ length: Math.ceil(Math.log10(high)) - first + 1 }, (_, at) => first + at);
    const inside = (factors) => powers.flatMap((power) => factors.map((factor) => factor * 10 ** power)).filter((value) => value >= low && value <= high);
    const ticks = inside(STEPS);
    if (ticks.length < FEW) return even(low, high);
    if (ticks.length <= MANY) return ticks;
    const tens = inside([1]);
    const every = Math.ceil(tens.length / MANY);
    return tens.filter((_, at) => at % every === 0);
  };

  bench.tickText = (value) => String(Number(value.toPrecision(6))); // without the noise of binary fractions
})();
