#pragma once

#include <pybind11/pybind11.h>

#include <vector>

#include "core/interface/summary.h"

/// Converts to a dict with the names of the C++ fields.
pybind11::dict ToDict(const bundle::SolveSummary& summary);
pybind11::dict ToDict(const bundle::IterationRecord& record);

/// One array per field, with one entry per iteration.
pybind11::dict ToArrays(const std::vector<bundle::IterationRecord>& records);

/// Adds the fields that python/bundle/interface/solve_record.py reads.
void PutRecord(const bundle::SolveRecord& record, pybind11::dict* result);

/// The inverse of ToArrays. Accepts sequences of equal length; throws InputError for others.
std::vector<bundle::IterationRecord> RecordsFromPython(const pybind11::dict& iterations);
