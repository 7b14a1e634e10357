"""Lets numba see the objects of controller and plant.

Compiled code holds an object as a pointer to its words. Reading and writing an attribute is a load
or a store at a known place; a list of numbers is seen as an array over its words; an object inside
another one, or in a list, is a pointer to its place. Methods and properties lead to their compiled
copies.
"""

from __future__ import annotations

import hashlib
import operator
from functools import cache
from types import ModuleType
from typing import Any

import numpy as np
from numba.core import cgutils, types
from numba.core.imputils import lower_builtin
from numba.core.typing.templates import AttributeTemplate
from numba.extending import (
    NativeValue,
    infer_getattr,
    lower_getattr_generic,
    lower_setattr_generic,
    overload_method,
    register_model,
    typeof_impl,
    unbox,
)

from adaptdrive_sim.compiled.layout import Attribute, Layout, layout_of, write
from adaptdrive_sim.compiled.lists import WORD, ListType, Pointer, make_list

_SCALAR_TYPES = {"float": types.float64, "int": types.int64, "bool": types.boolean}
_VECTOR_TYPES = {"floats": ListType(types.float64), "ints": ListType(types.int64)}


class ObjectType(types.Type):
    """Type of the objects of one layout."""

    def __init__(self, layout: Layout) -> None:
        self.layout = layout
        digest = hashlib.sha256(repr(layout).encode()).hexdigest()[:8]
        super().__init__(name=f"{layout.name}_{digest}")

    @property
    def key(self) -> Layout:
        """Key by which two types are equal."""
        return self.layout


class Memory:
    """An object copied to where compiled code can work on it.

    Attributes:
        layout: Of the object.
        kind: Its type in compiled code.
        words: Its memory.
        address: Where that begins.
    """

    def __init__(self, instance: Any) -> None:
        self.layout = layout_of(instance)
        self.kind = _type_of_layout(self.layout)
        self.words = np.zeros(max(1, self.layout.words), np.int64)
        self.address = self.words.ctypes.data
        self.load(instance)

    def load(self, instance: Any) -> None:
        """Copy the object again."""
        write(self.layout, instance, self.words)


class Copies:
    """The translated modules, by the names of the originals."""

    def __init__(self) -> None:
        self._modules: dict[str, ModuleType] = {}
        self._methods: set[str] = set()
        self._properties: set[tuple[str, str]] = set()

    def add(self, modules: dict[str, ModuleType]) -> None:
        """Make modules known, and the methods and properties of their classes."""
        self._modules.update(modules)
        for module, copy in modules.items():
            for name in vars(copy):
                owner, mark, attribute = name.partition("__")
                if owner and mark:
                    original = vars(getattr(copy, owner)).get(attribute)
                    self._announce(original, (module, name), attribute)

    def function(self, module: str, name: str) -> Any:
        """The compiled function, None where there is none."""
        return getattr(self._modules.get(module), name, None)

    def member(self, layout: Layout, name: str) -> Any:
        """The compiled method or property of a class, None where there is none."""
        return self.function(layout.module, f"{layout.name}__{name}")

    def property_of(self, layout: Layout, name: str) -> Any:
        """Type of the compiled property of a class, None where there is none."""
        if (layout.module, f"{layout.name}__{name}") not in self._properties:
            return None
        return types.Dispatcher(self.member(layout, name))

    def _announce(self, original: object, place: tuple[str, str], name: str) -> None:
        if isinstance(original, property):
            self._properties.add(place)
        elif original is not None and name not in self._methods:
            self._methods.add(name)
            overload_method(ObjectType, name)(_method(self, name))


def _method(copies: Copies, name: str) -> Any:
    def method(this: ObjectType, *arguments: Any) -> Any:  # noqa: ARG001  # shows how it is called
        function = copies.member(this.layout, name)
        if function is None:
            return None
        return lambda this, *arguments: function(this, *arguments)  # noqa: PLW0108  # numba's way

    method.__annotations__.clear()  # numba compares its signature with that of the lambda
    return method


copies = Copies()


register_model(ObjectType)(Pointer)


@cache
def _type_of_layout(layout: Layout) -> ObjectType:
    return ObjectType(layout)


@typeof_impl.register(Memory)
def _typeof_memory(value: Memory, _: Any) -> ObjectType:
    return value.kind


@unbox(ObjectType)
def _unbox_memory(_: ObjectType, value: Any, c: Any) -> NativeValue:
    address = c.pyapi.object_getattr_string(value, "address")
    pointer = c.pyapi.long_as_voidptr(address)
    c.pyapi.decref(address)
    return NativeValue(pointer)


@infer_getattr
class _Attributes(AttributeTemplate):
    key = ObjectType

    def generic_resolve(self, this: Any, name: str) -> Any:  # type: ignore[override]
        field = this.layout.find(name)
        if field is not None:
            return _type_of(field)
        found = copies.property_of(this.layout, name)
        if found is None:
            return None
        return found.get_call_type(self.context, (this,), {}).return_type


def _type_of(field: Attribute) -> Any:
    if field.part is not None:
        entry = ObjectType(field.part)
        return ListType(entry) if field.kind == "objects" else entry
    if field.kind == "function":
        return types.Dispatcher(copies.function(*field.function))
    return _SCALAR_TYPES.get(field.kind) or _VECTOR_TYPES[field.kind]


def _pointer(builder: Any, value: Any, field: Attribute, element: Any) -> Any:
    place = cgutils.gep(builder, value, field.offset * WORD)
    return builder.bitcast(place, element.as_pointer())


@lower_getattr_generic(ObjectType)
def _get(context: Any, builder: Any, this: ObjectType, value: Any, name: str) -> Any:
    field = this.layout.find(name)
    if field is None:
        return _call_property(context, builder, this, value, name)
    kind = _type_of(field)
    if isinstance(kind, ListType):
        count = context.get_constant(types.intp, field.length)
        first = cgutils.gep(builder, value, field.offset * WORD)
        return make_list(context, builder, kind, first, count)
    if field.part is not None:
        return cgutils.gep(builder, value, field.offset * WORD)
    if field.kind == "function":
        return context.get_dummy_value()
    word = context.get_value_type(types.float64 if field.kind == "float" else types.int64)
    loaded = builder.load(_pointer(builder, value, field, word))
    if field.kind == "bool":
        return context.cast(builder, loaded, types.int64, types.boolean)
    return loaded


def _call_property(context: Any, builder: Any, this: ObjectType, value: Any, name: str) -> Any:
    function = copies.property_of(this.layout, name)
    call = context.get_function(
        function, function.get_call_type(context.typing_context, (this,), {})
    )
    context.add_linking_libs(getattr(call, "libs", ()))
    return call(builder, (value,))


@lower_setattr_generic(ObjectType)
def _set(context: Any, builder: Any, signature: Any, args: Any, name: str) -> None:
    this, given = signature.args
    target, value = args
    field = this.layout.find(name)
    if field.kind in _VECTOR_TYPES:
        _store_vector(context, builder, field, given, target, value)
        return
    stored = types.float64 if field.kind == "float" else types.int64
    value = context.cast(builder, value, given, _SCALAR_TYPES[field.kind])
    if field.kind == "bool":
        value = context.cast(builder, value, types.boolean, types.int64)
    builder.store(value, _pointer(builder, target, field, context.get_value_type(stored)))


def _store_vector(
    context: Any, builder: Any, field: Attribute, given: Any, target: Any, value: Any
) -> None:
    """Copy a whole list: an object's lists keep their places, and their lengths."""
    source = context.make_helper(builder, given, value=value)
    size = context.get_constant(types.intp, field.length * WORD)
    place = cgutils.gep(builder, target, field.offset * WORD)
    cgutils.raw_memmove(builder, place, source.first, size, 1)


@lower_builtin(operator.is_, ObjectType, types.none)
def _is_none(context: Any, _: Any, signature: Any, __: Any) -> Any:
    return context.get_constant(types.boolean, signature.args[0].layout.absent)
